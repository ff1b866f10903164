//! The boundary to C: results, error texts, panics that stay inside, pointers that are checked.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// How a call ended; the same numbers as the exit status of the linkage program.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum linkage_result {
    /// Done.
    Ok = 0,
    /// The input did not allow an answer: nothing moved, nothing was recognised.
    NoAnswer = 1,
    /// What was given cannot be used.
    BadInput = 2,
    /// A fault of the library, or of one that it uses.
    Internal = 3,
}

/// A call that failed: how, and why in words.
pub(crate) struct Failure {
    pub result: linkage_result,
    pub text: String,
}

impl Failure {
    pub fn new(result: linkage_result, why: impl std::fmt::Display) -> Self {
        Self { result, text: why.to_string() }
    }

    pub fn bad(why: impl std::fmt::Display) -> Self {
        Self::new(linkage_result::BadInput, why)
    }

    pub fn no_answer(why: impl std::fmt::Display) -> Self {
        Self::new(linkage_result::NoAnswer, why)
    }

    pub fn internal(why: impl std::fmt::Display) -> Self {
        Self::new(linkage_result::Internal, why)
    }
}

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// A text as C has it; a NUL inside ends it.
pub(crate) fn c_text(text: &str) -> CString {
    let until_nul = text.split('\0').next().unwrap_or_default();
    CString::new(until_nul).expect("what precedes the first NUL holds none")
}

/// Runs a call's work; whatever goes wrong becomes its result and the thread's error text.
pub(crate) fn call(work: impl FnOnce() -> Result<(), Failure>) -> linkage_result {
    let failure = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(())) => return linkage_result::Ok,
        Ok(Err(failure)) => failure,
        Err(_) => Failure::internal("a fault inside Linkage; please report how to repeat it"),
    };
    // A thread that is ending has no text any more.
    let _ = LAST_ERROR.try_with(|last| *last.borrow_mut() = c_text(&failure.text));
    failure.result
}

/// Why the calling thread's last failed call failed; empty when none did. Valid until its next
/// call that fails.
#[unsafe(no_mangle)]
pub extern "C" fn linkage_last_error() -> *const c_char {
    LAST_ERROR.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

/// The library's version.
#[unsafe(no_mangle)]
pub extern "C" fn linkage_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}

/// What a caller's pointer refers to.
///
/// # Safety
/// Null, or valid for reads of a `T` while the reference lives.
pub(crate) unsafe fn given<'a, T>(pointer: *const T, what: &str) -> Result<&'a T, Failure> {
    // SAFETY: the caller of this function promises it.
    unsafe { pointer.as_ref() }.ok_or_else(|| Failure::bad(format!("{what} is NULL")))
}

/// A caller's place for a result.
///
/// # Safety
/// Null, or valid for writes of a `T` while the reference lives.
pub(crate) unsafe fn place<'a, T>(pointer: *mut T, what: &str) -> Result<&'a mut T, Failure> {
    // SAFETY: the caller of this function promises it.
    unsafe { pointer.as_mut() }.ok_or_else(|| Failure::bad(format!("{what} is NULL")))
}

/// A caller's text.
///
/// # Safety
/// Null, or a NUL-terminated string that is valid while the reference lives.
pub(crate) unsafe fn text<'a>(pointer: *const c_char, what: &str) -> Result<&'a str, Failure> {
    if pointer.is_null() {
        return Err(Failure::bad(format!("{what} is NULL")));
    }
    // SAFETY: not null, and the caller of this function promises the rest.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Failure::bad(format!("{what} is not UTF-8")))
}

/// A caller's text; `None` for NULL or an empty one.
///
/// # Safety
/// As [`text`].
pub(crate) unsafe fn optional_text<'a>(
    pointer: *const c_char,
    what: &str,
) -> Result<Option<&'a str>, Failure> {
    if pointer.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller of this function promises it.
    let text = unsafe { text(pointer, what) }?;
    Ok((!text.is_empty()).then_some(text))
}

/// Takes back what was given out as a handle.
///
/// # Safety
/// Null, or a handle that this library gave out and that nobody uses any more.
pub(crate) unsafe fn free<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: it came from `Box::into_raw`, and the caller of this function promises the rest.
        let owned = unsafe { Box::from_raw(handle) };
        // A fault while freeing stays inside as well.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(owned)));
    }
}
