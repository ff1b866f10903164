//! Why a motion ends before its target, and why an order is not followed.

use core::fmt;

/// Why a motion was braked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// It was cancelled.
    Cancelled,
    /// Something else is to be done.
    Replaced,
    /// No frame that tells where the joints are came for too long.
    NoFrame,
    /// The object is not seen any more.
    ObjectLost,
    /// The configuration of a joint that moves is not known any more.
    JointLost,
    /// The consumer's heartbeat did not come for too long.
    NoHeartbeat,
    /// Setpoints came too late: the pause was too long to catch up with.
    Stalled,
    /// The network took no setpoints for too long.
    NotSent,
    /// The service ends.
    ServiceEnds,
}

impl Reason {
    const ALL: [Self; 9] = [
        Self::Cancelled,
        Self::Replaced,
        Self::NoFrame,
        Self::ObjectLost,
        Self::JointLost,
        Self::NoHeartbeat,
        Self::Stalled,
        Self::NotSent,
        Self::ServiceEnds,
    ];

    /// What a setpoint says.
    pub fn text(self) -> &'static str {
        match self {
            Self::Cancelled => "cancelled",
            Self::Replaced => "another command came",
            Self::NoFrame => "no new frame",
            Self::ObjectLost => "object lost",
            Self::JointLost => "joint lost",
            Self::NoHeartbeat => "no heartbeat",
            Self::Stalled => "setpoints came too late",
            Self::NotSent => "the network takes no setpoints",
            Self::ServiceEnds => "the service ends",
        }
    }

    /// Its code, a number above 0.
    pub(crate) fn code(self) -> u32 {
        self as u32 + 1
    }

    /// The one with this code; none for 0.
    pub(crate) fn of(code: u32) -> Option<Self> {
        Self::ALL.get(code.checked_sub(1)? as usize).copied()
    }
}

/// Why an order was not followed. What runs goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// It came after the instant from which it was to go on.
    Late,
    /// It does not begin where the motion that runs is: the joint would jump.
    Jump,
    /// A motion is being braked; it comes to rest first.
    Braking,
    /// It was cancelled before it began.
    Cancelled,
    /// There is no fresh frame that tells where the joints are.
    NoFrame,
    /// A heartbeat is required, and none comes.
    NoHeartbeat,
}

impl Refusal {
    const ALL: [Self; 6] =
        [Self::Late, Self::Jump, Self::Braking, Self::Cancelled, Self::NoFrame, Self::NoHeartbeat];

    /// Its text.
    pub fn text(self) -> &'static str {
        match self {
            Self::Late => "the order came too late",
            Self::Jump => "it does not begin where the motion that runs is",
            Self::Braking => "what moves is being braked",
            Self::Cancelled => "it was cancelled before it began",
            Self::NoFrame => "no fresh frame tells where the joints are",
            Self::NoHeartbeat => "the consumer's heartbeat does not come",
        }
    }

    /// Its code, a number above 0.
    pub(crate) fn code(self) -> u32 {
        self as u32 + 1
    }

    /// The one with this code; none for 0.
    pub(crate) fn of(code: u32) -> Option<Self> {
        Self::ALL.get(code.checked_sub(1)? as usize).copied()
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_reason_has_a_number_and_a_text_of_its_own() {
        for (i, reason) in Reason::ALL.into_iter().enumerate() {
            assert_eq!(Reason::of(reason.code()), Some(reason));
            assert!(Reason::ALL[..i].iter().all(|r| r.text() != reason.text()));
        }
        for refusal in Refusal::ALL {
            assert_eq!(Refusal::of(refusal.code()), Some(refusal));
        }
        assert_eq!((Reason::of(0), Reason::of(99), Refusal::of(0)), (None, None, None));
    }
}
