//! A packet of any bytes behind the fingerprint of each message: refused, or a message that can
//! be encoded and is then the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use linkage_lcm::{Message, decode, encode, every_message};

fn check<M: Message>(body: &[u8]) {
    let packet = [&M::fingerprint().to_be_bytes(), body].concat();
    if let Ok(message) = decode::<M>(&packet) {
        let bytes = encode(&message).expect("what was decoded can be encoded");
        let again = decode::<M>(&bytes).expect("what was encoded can be decoded");
        assert_eq!(encode(&again).expect("it can be encoded"), bytes);
    }
}

macro_rules! check_one {
    ($($kind:ty),*) => {{
        const CHECKS: &[fn(&[u8])] = &[$(check::<$kind>),*];
        CHECKS
    }};
}

fuzz_target!(|input: (u8, &[u8])| {
    let checks = every_message!(check_one);
    checks[usize::from(input.0) % checks.len()](input.1);
});
