//! How passes of gs-shaders are dispatched: those of a view as its description says, those of gradients one module each, named as
//! their file.

mod project_backward;
mod rasterize_backward;
mod view;

pub(super) use project_backward::StoredSums;
