//! Fields of a protobuf message as bytes; a message is its fields one behind the other.

/// A text, bytes, or a message inside.
pub fn bytes(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![number << 3 | 2];
    push_varint(&mut out, bytes.len() as u64);
    [&out, bytes].concat()
}

/// A number of 32 bits.
pub fn fixed32(number: u8, value: u32) -> Vec<u8> {
    [&[number << 3 | 5], &value.to_le_bytes()[..]].concat()
}

/// A number of double precision.
pub fn double(number: u8, value: f64) -> Vec<u8> {
    [&[number << 3 | 1], &value.to_le_bytes()[..]].concat()
}

/// Numbers of double precision in a row.
pub fn doubles(number: u8, values: &[f64]) -> Vec<u8> {
    bytes(number, &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
}

/// A whole number.
pub fn varint(number: u8, value: u64) -> Vec<u8> {
    let mut out = vec![number << 3];
    push_varint(&mut out, value);
    out
}

fn push_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::protobuf::{Fields, Value};

    #[test]
    fn what_is_written_is_read_field_by_field() {
        let long = vec![7; 300];
        let message =
            [fixed32(2, 9), varint(3, 1 << 40), double(4, 0.5), bytes(15, &long)].concat();
        let fields: Vec<_> = Fields::new(&message).collect::<Result<_, _>>().unwrap();
        let half = Value::Fixed64(0.5_f64.to_le_bytes());
        assert_eq!(fields[..2], [(2, Value::Fixed32([9, 0, 0, 0])), (3, Value::Varint(1 << 40))]);
        assert_eq!(fields[2..], [(4, half), (15, Value::Bytes(&long))]);
    }
}
