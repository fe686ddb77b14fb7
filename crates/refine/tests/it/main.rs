//! The public interface of refine.

mod hard_cases;
mod refinement;
mod scenes;
