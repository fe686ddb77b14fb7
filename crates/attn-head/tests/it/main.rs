//! The public interface.

mod golden;
