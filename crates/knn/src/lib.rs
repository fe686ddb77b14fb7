//! Exact K nearest neighbours of every point of a 3D point set.
