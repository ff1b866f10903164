//! Foxglove's messages in JSON, as the same messages in protobuf, whose fields borrow from their bytes.
//! Bytes in JSON are base64.

use super::protobuf_writer::{bytes, double, doubles, fixed32, varint};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use std::borrow::Cow;

/// A message of a type, such as `foxglove.RawImage`, in protobuf.
///
/// # Errors
/// What is wrong, in a line.
pub fn in_protobuf(message_type: &str, json: &[u8]) -> Result<Vec<u8>, String> {
    let told = |e: serde_json::Error| format!("JSON that is no {message_type}: {e}");
    match message_type {
        "foxglove.RawImage" => serde_json::from_slice::<RawImage>(json).map_err(told)?.written(),
        "foxglove.CompressedImage" => {
            serde_json::from_slice::<CompressedImage>(json).map_err(told)?.written()
        }
        "foxglove.CameraCalibration" => {
            Ok(serde_json::from_slice::<Calibration>(json).map_err(told)?.written())
        }
        "foxglove.FrameTransform" => {
            Ok(serde_json::from_slice::<FrameTransform>(json).map_err(told)?.written())
        }
        "foxglove.FrameTransforms" => {
            let all: FrameTransforms = serde_json::from_slice(json).map_err(told)?;
            Ok(all.transforms.iter().flat_map(|one| bytes(1, &one.written())).collect())
        }
        other => Err(format!("{other} is not read")),
    }
}

#[derive(Deserialize)]
struct Time {
    sec: i64,
    nsec: u32,
}

#[derive(Deserialize)]
struct RawImage<'j> {
    timestamp: Time,
    #[serde(default)]
    frame_id: String,
    width: u32,
    height: u32,
    encoding: String,
    step: u32,
    #[serde(borrow)]
    data: Cow<'j, str>,
}

#[derive(Deserialize)]
struct CompressedImage<'j> {
    timestamp: Time,
    #[serde(default)]
    frame_id: String,
    #[serde(borrow)]
    data: Cow<'j, str>,
    format: String,
}

#[derive(Deserialize)]
struct Calibration {
    timestamp: Time,
    #[serde(default)]
    frame_id: String,
    width: u32,
    height: u32,
    #[serde(default)]
    distortion_model: String,
    #[serde(default, rename = "D")]
    d: Vec<f64>,
    #[serde(default, rename = "K")]
    k: Vec<f64>,
    #[serde(default, rename = "P")]
    p: Vec<f64>,
}

#[derive(Deserialize)]
struct FrameTransforms {
    transforms: Vec<FrameTransform>,
}

#[derive(Deserialize)]
struct FrameTransform {
    parent_frame_id: String,
    child_frame_id: String,
    translation: Vector,
    rotation: Quaternion,
}

#[derive(Deserialize)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Time {
    /// The field `timestamp`, which all messages begin with.
    fn written(&self) -> Vec<u8> {
        let whole = varint(1, self.sec.cast_unsigned());
        bytes(1, &[whole, varint(2, u64::from(self.nsec))].concat())
    }
}

impl RawImage<'_> {
    fn written(&self) -> Result<Vec<u8>, String> {
        Ok([
            self.timestamp.written(),
            fixed32(2, self.width),
            fixed32(3, self.height),
            bytes(4, self.encoding.as_bytes()),
            fixed32(5, self.step),
            bytes(6, &decoded(&self.data)?),
            bytes(7, self.frame_id.as_bytes()),
        ]
        .concat())
    }
}

impl CompressedImage<'_> {
    fn written(&self) -> Result<Vec<u8>, String> {
        let (data, format) = (decoded(&self.data)?, self.format.as_bytes());
        let frame = bytes(4, self.frame_id.as_bytes());
        Ok([self.timestamp.written(), bytes(2, &data), bytes(3, format), frame].concat())
    }
}

impl Calibration {
    fn written(&self) -> Vec<u8> {
        [
            self.timestamp.written(),
            fixed32(2, self.width),
            fixed32(3, self.height),
            bytes(4, self.distortion_model.as_bytes()),
            doubles(5, &self.d),
            doubles(6, &self.k),
            doubles(8, &self.p),
            bytes(9, self.frame_id.as_bytes()),
        ]
        .concat()
    }
}

impl FrameTransform {
    fn written(&self) -> Vec<u8> {
        let numbered = |values: &[f64]| -> Vec<u8> {
            values.iter().zip(1..).flat_map(|(value, number)| double(number, *value)).collect()
        };
        let Vector { x, y, z } = self.translation;
        let translation = numbered(&[x, y, z]);
        let Quaternion { x, y, z, w } = self.rotation;
        [
            bytes(2, self.parent_frame_id.as_bytes()),
            bytes(3, self.child_frame_id.as_bytes()),
            bytes(4, &translation),
            bytes(5, &numbered(&[x, y, z, w])),
        ]
        .concat()
    }
}

fn decoded(base64: &str) -> Result<Vec<u8>, String> {
    STANDARD.decode(base64).map_err(|e| format!("its data are no base64: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::foxglove;

    const TIME: &str = r#""timestamp":{"sec":12,"nsec":345678900}"#;

    fn written(message_type: &str, rest: &str) -> Vec<u8> {
        in_protobuf(message_type, format!("{{{TIME},{rest}}}").as_bytes()).unwrap()
    }

    #[test]
    fn pictures_in_json_are_those_of_protobuf() {
        let raw = r#""frame_id":"optical","width":1,"height":2,"encoding":"16UC1","step":2,"data":"AQIDBA==""#;
        let raw = written("foxglove.RawImage", raw);
        let image = foxglove::raw_image(&raw).unwrap();
        assert_eq!((image.header.utime, image.header.frame), (12_345_678, "optical"));
        assert_eq!((image.width, image.height, image.step), (1, 2, 2));
        assert_eq!((image.encoding, image.data), ("16UC1", &[1, 2, 3, 4][..]));
        let small = written("foxglove.CompressedImage", r#""data":"BwgJ","format":"png""#);
        let image = foxglove::compressed_image(&small).unwrap();
        assert_eq!((image.format, image.data), ("png", &[7, 8, 9][..]));
    }

    #[test]
    fn a_camera_and_transforms_in_json_are_those_of_protobuf() {
        let camera = r#""width":8,"height":6,"distortion_model":"plumb_bob","D":[0.1,0,0,0,0],
            "K":[30,0,3.5,0,31,2.5,0,0,1],"R":[],"P":[]"#;
        let camera = written("foxglove.CameraCalibration", camera);
        let info = foxglove::camera_calibration(&camera).unwrap();
        assert_eq!((info.width, info.height, info.k[0], info.k[4]), (8, 6, 30.0, 31.0));
        assert_eq!(info.d, [0.1, 0.0, 0.0, 0.0, 0.0]);
        let one = r#"{"timestamp":{"sec":1,"nsec":0},"parent_frame_id":"base","child_frame_id":"color",
            "translation":{"x":1,"y":2,"z":3},"rotation":{"x":0,"y":0,"z":0,"w":1}}"#;
        let several = format!("{{\"transforms\":[{one},{one}]}}");
        let several = in_protobuf("foxglove.FrameTransforms", several.as_bytes()).unwrap();
        let read = foxglove::frame_transforms(&several).unwrap();
        assert_eq!((read.len(), &*read[1].parent, &*read[1].child), (2, "base", "color"));
        assert_eq!(read[1].parent_from_child.translation.vector.as_slice(), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn what_is_no_such_message_is_told() {
        let said =
            |json: &str| in_protobuf("foxglove.CompressedImage", json.as_bytes()).unwrap_err();
        assert!(said("{").contains("no foxglove.CompressedImage"), "{}", said("{"));
        let spoilt = format!("{{{TIME},\"data\":\"?\",\"format\":\"png\"}}");
        assert!(said(&spoilt).contains("base64"), "{}", said(&spoilt));
    }
}
