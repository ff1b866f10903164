//! Names of frames of coordinates, each of one thing alone, whatever objects are called.
//!
//! The view's own frames are [`CAMERA`] and [`UPRIGHT`]. An object's base has the object's name, its
//! parts that name and `/partN`, a further object of its make that name and `#2`, `#3`, … So that no two
//! of these meet, `/`, `#` and `%` of an object's name are written `%2F`, `%23` and `%25`, and an object
//! that is called as a frame of the view is `camera#1` or `upright#1`.

use std::borrow::Cow;
use std::collections::BTreeMap;

/// The frame of the camera: x right, y down, z forward.
pub const CAMERA: &str = "camera";
/// A frame with z up that stays with the camera, so that viewers show scenes upright.
pub const UPRIGHT: &str = "upright";

/// The frame of an object, the first one that is shown of its name.
pub fn of_object(name: &str) -> String {
    of_instance(name, 1)
}

/// The frames of objects that are shown together, by their names.
pub fn of_objects<'n>(names: impl IntoIterator<Item = &'n str>) -> Vec<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let frame = |name| {
        let count = counts.entry(name).or_default();
        *count += 1;
        of_instance(name, *count)
    };
    names.into_iter().map(frame).collect()
}

/// The frame of a part of the object whose frame is given; the base's is the object's.
pub fn of_part(object: &str, part: usize) -> String {
    if part == 0 { object.to_owned() } else { format!("{object}/part{part}") }
}

fn of_instance(name: &str, number: usize) -> String {
    let is_taken = [CAMERA, UPRIGHT].contains(&name);
    let name = plain(name);
    if number == 1 && !is_taken { name.into_owned() } else { format!("{name}#{number}") }
}

/// A name without the characters that frames are made with.
fn plain(name: &str) -> Cow<'_, str> {
    if !name.contains(['%', '/', '#']) {
        return Cow::Borrowed(name);
    }
    // The first one first: the others bring it along.
    Cow::Owned(name.replace('%', "%25").replace('/', "%2F").replace('#', "%23"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn each_of_two_drawers_of_one_make_has_its_own_frames() {
        let objects = of_objects(["drawer", "door", "drawer"]);
        let parts: Vec<String> = objects.iter().map(|object| of_part(object, 1)).collect();
        assert_eq!(parts, ["drawer/part1", "door/part1", "drawer#2/part1"]);
        assert_eq!(of_part(&objects[0], 0), "drawer");
    }

    #[test]
    fn an_object_that_is_called_camera_is_not_the_camera() {
        assert_eq!(of_object("camera"), "camera#1");
        assert_eq!(
            of_objects(["camera", "upright", "camera"]),
            ["camera#1", "upright#1", "camera#2"]
        );
    }

    /// Names that try to be another one's frame.
    fn hostile_name() -> impl Strategy<Value = String> {
        let piece = prop::sample::select(vec![
            "camera", "upright", "drawer", "/part1", "/part2", "#1", "#2", "%2F", "%23", "%25",
        ]);
        prop::collection::vec(piece, 1..4).prop_map(|pieces| pieces.concat())
    }

    proptest! {
        #[test]
        fn no_two_frames_have_one_name(names in prop::collection::vec(hostile_name(), 1..8)) {
            let objects = of_objects(names.iter().map(String::as_str));
            let of_all = objects.iter().flat_map(|o| (0..3).map(|part| of_part(o, part)));
            let frames: Vec<String> =
                [CAMERA, UPRIGHT].map(str::to_owned).into_iter().chain(of_all).collect();
            let distinct: BTreeSet<&String> = frames.iter().collect();
            prop_assert_eq!(distinct.len(), frames.len(), "{:?}", frames);
            prop_assert_eq!(&objects[0], &of_object(&names[0]));
        }
    }
}
