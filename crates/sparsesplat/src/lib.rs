//! Posed photographs in, a compact set of 3D Gaussians out, in one pass.
