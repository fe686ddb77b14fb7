use super::context::Gpu;
use crate::Result;

impl Gpu {
    pub(super) fn self_test(&mut self) -> Result<()> {
        Ok(())
    }
}
