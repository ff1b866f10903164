//! Bindings to libfreenect.

use std::path::PathBuf;

fn main() {
    println!("cargo:rustc-link-lib=freenect");
    println!("cargo:rerun-if-changed=build.rs");
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    bindgen::Builder::default()
        .header_contents("wrapper.h", "#include <libfreenect.h>\n")
        .clang_arg("-I/usr/include/libusb-1.0")
        .allowlist_function("freenect_.*")
        .allowlist_type("freenect_.*")
        .generate_comments(false)
        .generate()
        .expect("bindings to libfreenect.h; tools/setup installs libfreenect-dev")
        .write_to_file(out.join("freenect.rs"))
        .expect("OUT_DIR can be written");
}
