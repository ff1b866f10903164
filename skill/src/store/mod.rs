//! The store: one SQLite file with models, appearance, words and provenance. Every change is one
//! transaction, so that a process that is killed leaves the state before it. All that is kept has a
//! checksum, and so has the list of all objects: damage is reported, and never gives a wrong
//! answer.
//!
//! [`Store`] opens the file, puts objects in and takes them out; [`Library`] is all that a store
//! holds, to be looked for in pictures.

mod contents;
#[cfg(test)]
mod contents_tests;
#[cfg(test)]
mod damage;
mod database;
mod error;
mod file;
mod inverted_index;
mod library;
#[cfg(test)]
mod listing;
pub(crate) mod record;
pub(crate) mod schema;
#[cfg(test)]
mod test_data;
mod transaction;

pub use database::{Revision, Store};
pub use error::{DatabaseError, StoreError};
pub use library::Library;
