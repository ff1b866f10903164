//! Generates Rust types from `types/*.lcm` and bindings to liblcm.

#[path = "build/generate.rs"]
mod generate;
#[path = "build/idl.rs"]
mod idl;

use std::path::PathBuf;

fn main() {
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    println!("cargo:rerun-if-changed=types");
    println!("cargo:rerun-if-changed=build");
    let structs = idl::read_folder("types");
    std::fs::write(out.join("messages.rs"), generate::rust(&structs))
        .expect("OUT_DIR can be written");

    // pkg-config's lcm.pc asks for glib's, which the headers do not need.
    println!("cargo:rustc-link-lib=lcm");
    println!("cargo:rerun-if-changed=build/wrapper.h");
    bindgen::Builder::default()
        .header("build/wrapper.h")
        .allowlist_function("lcm_(create|destroy|publish|subscribe|unsubscribe|handle_timeout|get_fileno|subscription_set_queue_capacity)")
        .allowlist_type("lcm_recv_buf_t|lcm_t|lcm_subscription_t")
        .generate()
        .expect("bindings to /usr/include/lcm/lcm.h; tools/setup installs liblcm-dev and libclang-dev")
        .write_to_file(out.join("liblcm.rs"))
        .expect("OUT_DIR can be written");
}
