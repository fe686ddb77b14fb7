//! Local Shannon entropy of an image, and pixel sampling by it.
