//! Who may command the service, and for how long a command holds.
//!
//! Whatever moves a robot must be meant for this service, now. A command carries the session of
//! the service (a log that is played back carries another one) and the time at which it was sent.
//! The rig may name the addresses that commands come from, and a shared key with which they are
//! signed.

use crate::limits::Access;
use hmac::{Hmac, KeyInit, Mac};
use linkage_driver::text_table::read_up_to;
use linkage_lcm::encode;
use linkage_lcm::messages::linkage;
use sha2::Sha256;
use std::fs::File;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// Why a command is not obeyed, whatever it asks for.
#[derive(Debug, Clone, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum Unauthorised {
    /// The rig names who may command, and the sender is not among them.
    #[error("it comes from {sender}, and the rig lets only {allowed} command", sender = .sender.map_or("an unknown address".to_owned(), |s| s.to_string()))]
    Sender {
        /// Address of the sender, where the network tells it.
        sender: Option<IpAddr>,
        /// Addresses that may.
        allowed: String,
    },
    /// The signature is missing or was made with another key.
    #[error("its signature is {found}: sign commands with the rig's key")]
    Signature {
        /// What is wrong with it.
        found: &'static str,
    },
    /// It is for another run of the service.
    #[error(
        "it is for session {found}, and this is session {session}: take the session from the service's status"
    )]
    Session {
        /// The command's.
        found: i64,
        /// The service's.
        session: i64,
    },
    /// It was sent too long ago, or its expiry has passed.
    #[error(
        "it was sent {age:.1} s ago, and a command holds for {limit:.1} s: send a new one, and see that both clocks agree"
    )]
    TooOld {
        /// Seconds since it was sent.
        age: f64,
        /// Seconds for which it held.
        limit: f64,
    },
    /// Its time lies ahead.
    #[error("it was sent {ahead:.1} s from now: see that both clocks agree")]
    Ahead {
        /// Seconds.
        ahead: f64,
    },
}

impl Unauthorised {
    /// The sender may know the result of the command. Who is not allowed to command gets no answer:
    /// it could speak for another sender's command.
    pub fn is_answered(&self) -> bool {
        !matches!(self, Self::Sender { .. } | Self::Signature { .. })
    }
}

/// A key that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyError {
    /// The file cannot be read.
    #[error("{path}: the key for commands cannot be read")]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The key is too short to keep anybody out.
    #[error("{path}: the key for commands has {found} bytes; it needs at least {LEAST_KEY}")]
    Short {
        /// The file.
        path: PathBuf,
        /// Its bytes.
        found: usize,
    },
}

/// Bytes of a key at least.
const LEAST_KEY: usize = 16;
/// Bytes of its file at most.
const MOST_KEY: u64 = 4096;

/// A key that signs commands: HMAC-SHA256.
#[derive(Clone)]
pub struct CommandKey(Hmac<Sha256>);

impl CommandKey {
    /// Reads a key from a file; white space at its end does not count.
    ///
    /// # Errors
    /// [`KeyError`] names the file.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let bytes = File::open(path)
            .and_then(|file| read_up_to(MOST_KEY, file))
            .map_err(|source| KeyError::Read { path: path.to_owned(), source })?;
        let key = bytes.trim_ascii_end();
        let short = KeyError::Short { path: path.to_owned(), found: key.len() };
        if key.len() < LEAST_KEY { Err(short) } else { Self::new(key).ok_or(short) }
    }

    fn new(key: &[u8]) -> Option<Self> {
        Hmac::new_from_slice(key).ok().map(Self)
    }

    /// Signs a command: its signature is of all the rest.
    pub fn sign(&self, command: &mut linkage::Command) {
        command.signature = Vec::new();
        if let Some(signed) = self.of(command) {
            command.signature = signed.finalize().into_bytes().to_vec();
        }
    }

    /// Compares in a time that tells nothing of the right signature.
    fn is_right(&self, command: &linkage::Command) -> bool {
        let unsigned = linkage::Command { signature: Vec::new(), ..command.clone() };
        self.of(&unsigned).is_some_and(|right| right.verify_slice(&command.signature).is_ok())
    }

    fn of(&self, unsigned: &linkage::Command) -> Option<Hmac<Sha256>> {
        let mut mac = self.0.clone();
        mac.update(&encode(unsigned).ok()?);
        Some(mac)
    }
}

/// Decides which commands are obeyed.
pub struct Authority {
    /// When the service began, microseconds since 1970: it names this run.
    session: i64,
    command_age_us: i64,
    allowed: Vec<IpAddr>,
    key: Option<CommandKey>,
}

impl Authority {
    /// The authority of a service that begins now. `command_age` in seconds.
    ///
    /// # Errors
    /// [`KeyError`] when the rig names a key that cannot be used.
    pub fn new(session: i64, command_age: f64, access: &Access) -> Result<Self, KeyError> {
        let key = access.key_file.as_deref().map(CommandKey::read).transpose()?;
        let command_age_us = (command_age * 1e6) as i64;
        Ok(Self { session, command_age_us, allowed: access.addresses.clone(), key })
    }

    /// Who sent it may command.
    ///
    /// # Errors
    /// [`Unauthorised`].
    pub fn identify(
        &self,
        command: &linkage::Command,
        sender: Option<IpAddr>,
    ) -> Result<(), Unauthorised> {
        self.identify_address(sender)?;
        match &self.key {
            Some(_) if command.signature.is_empty() => {
                Err(Unauthorised::Signature { found: "missing" })
            }
            Some(key) if !key.is_right(command) => Err(Unauthorised::Signature { found: "wrong" }),
            _ => Ok(()),
        }
    }

    /// Whoever sends from this address may command, as far as addresses go.
    ///
    /// # Errors
    /// [`Unauthorised::Sender`].
    pub fn identify_address(&self, sender: Option<IpAddr>) -> Result<(), Unauthorised> {
        if !self.allowed.is_empty() && !sender.is_some_and(|s| self.allowed.contains(&s)) {
            let allowed: Vec<String> = self.allowed.iter().map(IpAddr::to_string).collect();
            return Err(Unauthorised::Sender { sender, allowed: allowed.join(", ") });
        }
        Ok(())
    }

    /// Who sends from this address may be answered without a signature: where one is asked for, anybody could speak for
    /// another's command else.
    pub fn may_be_told_unsigned(&self, sender: Option<IpAddr>) -> bool {
        self.key.is_none() && self.identify_address(sender).is_ok()
    }

    /// It is meant for this service, as it runs now.
    ///
    /// # Errors
    /// [`Unauthorised::Session`].
    pub fn is_of_session(&self, command: &linkage::Command) -> Result<(), Unauthorised> {
        let (found, session) = (command.session, self.session);
        if found == session { Ok(()) } else { Err(Unauthorised::Session { found, session }) }
    }

    /// It is meant for this service and still holds; until when it does, microseconds since 1970.
    ///
    /// # Errors
    /// [`Unauthorised`].
    pub fn valid_until(&self, command: &linkage::Command, now: i64) -> Result<i64, Unauthorised> {
        self.is_of_session(command)?;
        let seconds = |us: i64| us as f64 * 1e-6;
        let age = now.saturating_sub(command.utime);
        if age < -self.command_age_us {
            return Err(Unauthorised::Ahead { ahead: -seconds(age) });
        }
        let latest = command.utime.saturating_add(self.command_age_us);
        let until = match command.expiry_utime {
            0 => latest,
            expiry => latest.min(expiry),
        };
        if command.utime < self.session || now > until {
            let limit = seconds(until.saturating_sub(command.utime)).max(0.0);
            return Err(Unauthorised::TooOld { age: seconds(age), limit });
        }
        Ok(until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SESSION: i64 = 1_700_000_000_000_000;
    const SECOND: i64 = 1_000_000;

    fn authority(access: &Access) -> Authority {
        Authority::new(SESSION, 1.0, access).unwrap()
    }

    fn command(utime: i64) -> linkage::Command {
        linkage::Command { utime, schema: 2, session: SESSION, ..Default::default() }
    }

    #[test]
    fn a_command_of_this_session_holds_for_its_time() {
        let authority = authority(&Access::default());
        let sent = SESSION + 5 * SECOND;
        let at = |now| authority.valid_until(&command(sent), now);
        assert_eq!(at(sent), Ok(sent + SECOND));
        assert_eq!(at(sent + SECOND), Ok(sent + SECOND));
        assert!(matches!(at(sent + SECOND + 1), Err(Unauthorised::TooOld { .. })));
        assert!(matches!(at(sent - 2 * SECOND), Err(Unauthorised::Ahead { .. })));
    }

    #[test]
    fn an_expiry_shortens_but_never_lengthens() {
        let authority = authority(&Access::default());
        let sent = SESSION + SECOND;
        let until = |expiry_utime| {
            let command = linkage::Command { expiry_utime, ..command(sent) };
            authority.valid_until(&command, sent)
        };
        assert_eq!(until(sent + 1000), Ok(sent + 1000));
        assert_eq!(until(sent + 60 * SECOND), Ok(sent + SECOND));
        assert!(until(sent - 1).is_err());
        assert!(until(i64::MIN).is_err() && until(i64::MAX).is_ok());
    }

    #[test]
    fn a_log_that_is_played_back_moves_nothing() {
        let authority = authority(&Access::default());
        let old = linkage::Command { session: SESSION - 7, ..command(SESSION - 3600 * SECOND) };
        let refusal = authority.valid_until(&old, SESSION + SECOND).unwrap_err();
        assert!(matches!(refusal, Unauthorised::Session { .. }));
        // Played back into the service that it was recorded from, it is too old.
        let own = command(SESSION + SECOND);
        assert!(authority.valid_until(&own, SESSION + 60 * SECOND).is_err());
        // Clocks cannot be driven over their ends.
        for utime in [i64::MIN, i64::MAX, 0] {
            assert!(authority.valid_until(&command(utime), SESSION).is_err());
        }
    }

    #[test]
    fn from_before_the_service_began_is_refused() {
        let authority = authority(&Access::default());
        assert!(authority.valid_until(&command(SESSION - 10), SESSION + 10).is_err());
    }

    #[test]
    fn only_named_addresses_may_command() {
        let access = Access { addresses: vec!["10.0.0.7".parse().unwrap()], ..Access::default() };
        let authority = authority(&access);
        let from = |s: &str| authority.identify(&command(SESSION), s.parse().ok());
        assert_eq!(from("10.0.0.7"), Ok(()));
        let refusal = from("10.0.0.8").unwrap_err();
        assert!(refusal.to_string().contains("10.0.0.8") && !refusal.is_answered());
        assert!(authority.identify(&command(SESSION), None).is_err());
    }

    #[test]
    fn with_a_key_only_what_it_signed_is_obeyed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        std::fs::write(&path, "a secret of the rig, long enough\n").unwrap();
        let access = Access { key_file: Some(path.clone()), ..Access::default() };
        let authority = authority(&access);
        let key = CommandKey::read(&path).unwrap();
        let mut signed = command(SESSION + 1);
        assert!(authority.identify(&signed, None).is_err());
        assert!(!authority.may_be_told_unsigned(None), "nobody speaks for another's command");
        key.sign(&mut signed);
        assert_eq!(authority.identify(&signed, None), Ok(()));
        // Whatever is changed afterwards was not signed.
        let others = [
            linkage::Command { action: 3, ..signed.clone() },
            linkage::Command { target: "open".into(), ..signed.clone() },
            linkage::Command { utime: signed.utime + 1, ..signed.clone() },
            linkage::Command { signature: signed.signature[..31].to_vec(), ..signed.clone() },
        ];
        for other in others {
            assert!(authority.identify(&other, None).is_err());
        }
    }

    #[test]
    fn a_key_that_keeps_nobody_out_is_refused_by_its_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        std::fs::write(&path, "short\n").unwrap();
        let refusal = CommandKey::read(&path).err().unwrap().to_string();
        assert!(refusal.contains("key") && refusal.contains("5 bytes"), "{refusal}");
        assert!(CommandKey::read(&dir.path().join("none")).is_err());
    }
}
