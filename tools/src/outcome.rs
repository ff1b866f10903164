//! How a command ends: with its answer, or with a failure and the exit status of the program.

use anyhow::anyhow;
use linkage_skill::VisionError;

/// A command that failed, with its exit status.
pub struct Failure {
    /// 1: no answer; 2: usage or bad input; 3: internal.
    pub status: u8,
    /// Why, with its chain of causes.
    pub cause: anyhow::Error,
}

/// The input did not allow an answer.
pub const NO_ANSWER: u8 = 1;
/// Usage or bad input.
pub const BAD_INPUT: u8 = 2;
/// A fault of this program or of a library that it uses.
pub const INTERNAL: u8 = 3;

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        let cause = error.into();
        let internal = cause.chain().any(|e| e.is::<opencv::Error>() || e.is::<VisionError>());
        Self { status: if internal { INTERNAL } else { BAD_INPUT }, cause }
    }
}

impl Failure {
    /// The input did not allow an answer.
    pub fn no_answer(message: impl std::fmt::Display) -> Self {
        Self { status: NO_ANSWER, cause: anyhow!("{message}") }
    }
}

/// How a command ends.
pub type Outcome<T = ()> = Result<T, Failure>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_of_the_vision_library_is_internal_and_other_errors_are_bad_input() {
        let vision = opencv::Error::new(opencv::core::StsError, "broken");
        let with_context = anyhow::Error::new(vision).context("frame 3");
        assert_eq!(Failure::from(with_context).status, INTERNAL);
        assert_eq!(Failure::from(anyhow!("no such file")).status, BAD_INPUT);
        assert_eq!(Failure::no_answer("nothing moves").status, NO_ANSWER);
    }
}
