//! Times, places and colours as Foxglove's messages hold them.

use foxglove::messages::{Color, Point3 as Place, Pose as Placed, Quaternion, Timestamp, Vector3};
use linkage_skill::Pose;
use nalgebra::Point3;

/// Nanoseconds of a time stamp in microseconds; 0 for one before 1970.
pub fn nanoseconds(utime: i64) -> u64 {
    u64::try_from(utime).unwrap_or(0).saturating_mul(1000)
}

/// A time stamp in microseconds.
pub fn timestamp(utime: i64) -> Timestamp {
    let ns = nanoseconds(utime);
    let (s, ns) = (ns / 1_000_000_000, ns % 1_000_000_000);
    u32::try_from(s).map_or(Timestamp::MAX, |s| Timestamp::new(s, ns as u32))
}

/// A pose.
pub fn pose(pose: &Pose) -> Placed {
    let (translation, rotation) = translation_and_rotation(pose);
    Placed { position: Some(translation), orientation: Some(rotation) }
}

/// A pose in two pieces.
pub fn translation_and_rotation(pose: &Pose) -> (Vector3, Quaternion) {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    (Vector3 { x: t.x, y: t.y, z: t.z }, Quaternion { x: q.i, y: q.j, z: q.k, w: q.w })
}

/// A place.
pub fn place(p: &Point3<f64>) -> Place {
    Place { x: p.x, y: p.y, z: p.z }
}

/// A colour, from 0 (not seen) to 1 (opaque).
pub fn colour(rgb: [u8; 3], opacity: f64) -> Color {
    let [r, g, b] = rgb.map(|c| f64::from(c) / 255.0);
    Color { r, g, b, a: opacity }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_stamps_that_no_message_can_hold_become_the_nearest() {
        assert_eq!(timestamp(1_500_000), Timestamp::new(1, 500_000_000));
        assert_eq!((timestamp(-1), nanoseconds(-1)), (Timestamp::MIN, 0));
        assert_eq!(timestamp(i64::MAX), Timestamp::MAX);
    }
}
