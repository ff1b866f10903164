//! The messages, a module a package.

include!(concat!(env!("OUT_DIR"), "/messages.rs"));
