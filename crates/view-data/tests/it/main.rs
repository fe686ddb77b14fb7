//! `folder` makes data sets to read; `nerfstudio` reads their JSON, `colmap` models, `sequences` folders of one camera,
//! `load` their pictures and depth, `open` recognises layouts, `stream` gives views one by one, `lens` checks the
//! distortion model, `index` the evaluation index, `select` the choice of views.

#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

mod folder;
mod samples;
mod torch_file;

mod chunk;
mod colmap;
mod dl3dv;
mod index;
mod lens;
mod load;
mod nerfstudio;
mod open;
mod pickle;
mod ply;
mod re10k;
mod select;
mod sequences;
mod stream;
mod write;
