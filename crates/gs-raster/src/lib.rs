//! A tiled, parallel f32 renderer of 3D Gaussians on the CPU.
