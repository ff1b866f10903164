//! Packets of any bytes behind the fingerprint of each message.

use linkage_lcm::{Message, decode, encode, every_message};
use proptest::prelude::*;

/// Memory that decoding may take, for each byte of a packet: an empty string is 5 bytes there and
/// 24 here, an empty array of variable length 4 there and 24 here.
const MEMORY_PER_BYTE: u64 = 16;

fn packet<M: Message>(body: &[u8]) -> Vec<u8> {
    [&M::fingerprint().to_be_bytes(), body].concat()
}

/// What is decoded can be encoded, and is then the same; and decoding takes no more memory than
/// the packet accounts for.
fn check<M: Message>(body: &[u8]) {
    let packet = packet::<M>(body);
    let mut decoded = None;
    let memory = allocation_counter::measure(|| decoded = Some(decode::<M>(&packet)));
    let most = 256 + MEMORY_PER_BYTE * packet.len() as u64;
    assert!(memory.bytes_max <= most, "{}: {} bytes for {most}", M::NAME, memory.bytes_max);
    if let Some(Ok(message)) = decoded {
        let bytes = encode(&message).unwrap();
        let again = encode(&decode::<M>(&bytes).unwrap()).unwrap();
        assert_eq!(bytes, again, "{}", M::NAME);
    }
}

macro_rules! check_each {
    ($($kind:ty),*) => {
        fn check_each(body: &[u8]) {
            $(check::<$kind>(body);)*
        }
    };
}
every_message!(check_each);

macro_rules! least_bytes {
    ($($kind:ty),*) => {[$((
        <$kind as Message>::NAME,
        <$kind as Message>::LEAST_BYTES,
        encode(&<$kind>::default()).unwrap().len() - 8,
    )),*]};
}

#[test]
fn the_fewest_bytes_of_each_message_are_those_of_an_empty_one() {
    for (name, least, empty) in every_message!(least_bytes) {
        assert_eq!(least, empty, "{name}");
    }
}

#[test]
fn a_packet_of_64_kib_takes_little_memory_whatever_it_claims() {
    for word in [0_u32, 1, 2, 3, 4, 5, 100, 1000, 3000, 16_000, 65_000, i32::MAX as u32, u32::MAX] {
        for shift in 0..8 {
            let words = std::iter::repeat_n(word.to_be_bytes(), 1 << 14).flatten();
            check_each(&[0].repeat(shift).into_iter().chain(words).collect::<Vec<u8>>());
        }
    }
}

proptest! {
    #[test]
    fn no_bytes_make_a_decoder_panic(body in proptest::collection::vec(any::<u8>(), 0..300)) {
        check_each(&body);
    }

    #[test]
    fn no_lengths_make_a_decoder_take_more_than_there_is(
        words in proptest::collection::vec(
            prop_oneof![Just(0_u32), Just(1), Just(2), Just(4), 0_u32..3000, any::<u32>()],
            0..3000,
        ),
    ) {
        check_each(&words.iter().flat_map(|w| w.to_be_bytes()).collect::<Vec<u8>>());
    }
}
