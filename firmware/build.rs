//! Passes the memory of the board and the layout of `cortex-m-rt` to the linker.

fn main() {
    let here = std::env::var("CARGO_MANIFEST_DIR").expect("cargo says where the manifest is");
    println!("cargo:rustc-link-search={here}");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=--nmagic");
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=build.rs");
}
