//! Raw bindings to OpenNI2, as its headers have them. `linkage-driver` wraps them safely.
#![allow(non_camel_case_types, non_upper_case_globals, non_snake_case, missing_docs)]

include!(concat!(env!("OUT_DIR"), "/openni2.rs"));
