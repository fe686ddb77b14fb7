//! Pixels, depth and a camera to oriented 3D anchors.
