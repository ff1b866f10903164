//! Bindings to OpenNI2's C interface.

use std::path::PathBuf;

fn main() {
    println!("cargo:rustc-link-lib=OpenNI2");
    println!("cargo:rerun-if-changed=build.rs");
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    bindgen::Builder::default()
        .header_contents("wrapper.hpp", "#include <OniCAPI.h>\n#include <OniCProperties.h>\n")
        .clang_args(["-x", "c++", "-I/usr/include/openni2"])
        .allowlist_function("oni.*")
        .allowlist_type("Oni.*")
        .allowlist_var("ONI_.*")
        .generate_comments(false)
        .generate()
        .expect("bindings to OniCAPI.h; tools/setup installs libopenni2-dev")
        .write_to_file(out.join("openni2.rs"))
        .expect("OUT_DIR can be written");
}
