//! One file a command. `main.rs` says which command line leads to which.

pub mod command;
pub mod config;
pub mod demo;
pub mod destination;
pub mod doctor;
pub mod export;
pub mod fit;
pub mod learn;
pub mod listen;
pub mod predict;
pub mod recognise;
pub mod record;
pub mod replay;
pub mod serve;
pub mod simulate;
pub mod store;
pub mod vocabulary;
