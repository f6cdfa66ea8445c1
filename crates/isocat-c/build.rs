//! Gives the shared library the name by which programs find it: one that changes with what they can't be linked with any more.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("linux") {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libisocat.so.0");
    }
}
