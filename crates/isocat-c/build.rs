//! Sets the name by which programs find the shared library; it changes when programs can no longer
//! be linked with it. Also packs the relocations, which are a twentieth of its size; a linker that
//! does not support this prints a message and continues.

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
