//! Linker flags of a Python extension module.

fn main() {
    // The interpreter that loads the module has Python's symbols; macOS wants to be told that they come later.
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("macos") {
        println!("cargo:rustc-link-arg-cdylib=-undefined");
        println!("cargo:rustc-link-arg-cdylib=dynamic_lookup");
    }
}
