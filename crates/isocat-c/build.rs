//! Gives the shared library the name by which programs find it: one that changes with what they
//! can't be linked with any more. And packs its relocations, a twentieth of its size; a linker that
//! does not know how says so and goes on.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let target = |what: &str| std::env::var(format!("CARGO_CFG_TARGET_{what}")).unwrap_or_default();
    if target("OS") == "linux" {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libisocat.so.0");
    }
    if target("OS") == "linux" && target("ENV") == "gnu" {
        println!("cargo:rustc-cdylib-link-arg=-Wl,-z,pack-relative-relocs");
    }
}
