//! The program's allocator, which is not written in Rust.

#![allow(unsafe_code)]

use libmimalloc_sys::{mi_option_set_default, mi_option_t};

/// Memory that one thread takes and another gives back stays bounded.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// `mi_option_purge_delay`, which the binding does not name: the same number in versions 2 and 3.
const PURGE_DELAY: mi_option_t = 15;
/// Longer than a frame takes: its pictures are as large as those of the next one.
const MILLISECONDS: std::ffi::c_long = 1000;

/// Keeps memory that was given back for a while before the system gets it, unless the
/// environment says otherwise (`MIMALLOC_PURGE_DELAY`): each frame would fetch it again.
pub fn keep_for_the_next_frame() {
    // SAFETY: sets a number that the allocator reads whenever it gives memory back; it is called
    // once, before threads are started.
    unsafe { mi_option_set_default(PURGE_DELAY, MILLISECONDS) }
}
