//! Coloured places as a point cloud.

use super::convert::timestamp;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{PackedElementField, PointCloud, Pose, Quaternion, Vector3};
use nalgebra::Point3;

/// Bytes of a point: three coordinates, and red, green, blue and opacity.
const STRIDE: u32 = 16;

/// A place with its colour and opacity.
pub type Dot = (Point3<f64>, [u8; 4]);

/// Places in a frame, metres.
pub fn cloud(utime: i64, frame_id: &str, dots: impl IntoIterator<Item = Dot>) -> PointCloud {
    let mut data = Vec::new();
    for (place, rgba) in dots {
        place.iter().for_each(|x| data.extend((*x as f32).to_le_bytes()));
        data.extend(rgba);
    }
    let field = |(name, offset, kind): (&str, u32, NumericType)| PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: kind.into(),
    };
    let (metres, shade) = (NumericType::Float32, NumericType::Uint8);
    let fields = [
        ("x", 0, metres),
        ("y", 4, metres),
        ("z", 8, metres),
        ("red", 12, shade),
        ("green", 13, shade),
        ("blue", 14, shade),
        ("alpha", 15, shade),
    ];
    PointCloud {
        timestamp: Some(timestamp(utime)),
        frame_id: frame_id.to_owned(),
        pose: Some(Pose {
            position: Some(Vector3::default()),
            orientation: Some(Quaternion { w: 1.0, ..Quaternion::default() }),
        }),
        point_stride: STRIDE,
        fields: fields.into_iter().map(field).collect(),
        data: data.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_as_long_as_its_fields_say() {
        let dots = [(Point3::new(1.0, 2.0, 3.0), [1, 2, 3, 255]); 2];
        let cloud = cloud(0, "camera", dots);
        assert_eq!(cloud.data.len(), 2 * cloud.point_stride as usize);
        let blue = cloud.fields.iter().find(|f| f.name == "blue").unwrap().offset as usize;
        assert_eq!(cloud.data[blue], 3);
    }
}
