//! The public interface.

mod case;
mod files;
mod golden;
mod gradients;
mod hostile;
mod oracle;
mod properties;
