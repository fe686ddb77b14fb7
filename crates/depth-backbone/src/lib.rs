//! Depth, confidence and features per view: measured depth, or multi-view stereo by plane sweep.
