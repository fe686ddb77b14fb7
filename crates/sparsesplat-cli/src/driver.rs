//! What graphics drivers print of their own accord. They write to the process's standard error, past everything of ours, also where they
//! find nothing to complain about that concerns the user.

/// Runs what wakes graphics drivers; what is written to standard error meanwhile, by anybody, does not reach the user.
#[cfg(unix)]
pub(crate) fn quietly<T>(wake: impl FnOnce() -> T) -> T {
    use std::fs::File;
    use std::os::fd::OwnedFd;

    /// Gives standard error back, after a panic too.
    struct GiveBack(OwnedFd);
    impl Drop for GiveBack {
        fn drop(&mut self) {
            // Nothing is left that could be told.
            let _ = rustix::stdio::dup2_stderr(&self.0);
        }
    }

    let kept = std::io::stderr();
    let kept = rustix::io::fcntl_dupfd_cloexec(&kept, 0).map(GiveBack);
    let nothing = File::options().write(true).open("/dev/null");
    // Where there is no standard error, or no /dev/null, drivers may say what they like.
    if let (Ok(_kept), Ok(nothing)) = (kept, nothing)
        && rustix::stdio::dup2_stderr(&nothing).is_ok()
    {
        return wake();
    }
    wake()
}

/// Runs what wakes graphics drivers.
#[cfg(not(unix))]
pub(crate) fn quietly<T>(wake: impl FnOnce() -> T) -> T {
    wake()
}

#[cfg(all(test, unix))]
mod tests {
    use super::quietly;
    use std::process::Command;

    /// Set where this test runs as its own child.
    const CHILD: &str = "SPARSESPLAT_TEST_QUIETLY";

    #[test]
    fn drivers_are_not_heard_and_everybody_else_is_afterwards() {
        // As a driver does: straight to the process's standard error.
        let say = |text: &str| {
            let said = Command::new("sh").args(["-c", "echo $0 >&2", text]).status();
            assert!(said.unwrap().success());
        };
        if std::env::var_os(CHILD).is_some() {
            assert_eq!(
                quietly(|| {
                    say("chatter");
                    7
                }),
                7
            );
            let panicked = std::panic::catch_unwind(|| quietly(|| panic!("of a driver")));
            assert!(panicked.is_err());
            say("afterwards");
            return;
        }
        let name = "driver::tests::drivers_are_not_heard_and_everybody_else_is_afterwards";
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", name, "--nocapture"])
            .env(CHILD, "1")
            .output()
            .unwrap();
        let heard = String::from_utf8(child.stderr).unwrap();
        assert!(child.status.success() && heard.contains("afterwards"), "{heard}");
        assert!(!heard.contains("chatter"), "{heard}");
    }
}
