//! The skill for C and C++. `include/linkage.h` is made from this crate; `example/` shows its use.
//!
//! Each function catches panics, checks what it is given, and keeps a text for the calling thread
//! when it fails. All unsafe code of the interface is in this crate: reading what a caller points
//! at, and giving out and taking back handles.
#![allow(unsafe_code)]

mod answers;
mod boundary;
mod frame;
mod session;

pub use answers::*;
pub use boundary::*;
pub use frame::*;
pub use session::*;
