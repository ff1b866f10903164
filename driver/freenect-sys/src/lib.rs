//! Raw bindings to libfreenect, as its header has them. `linkage-driver` wraps them safely.
#![allow(non_camel_case_types, non_upper_case_globals, non_snake_case, missing_docs)]

include!(concat!(env!("OUT_DIR"), "/freenect.rs"));
