//! The obvious f64 renderer of 3D Gaussians that judges the fast ones.
