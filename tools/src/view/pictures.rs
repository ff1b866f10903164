//! A frame as pictures: colour as JPEG, depth in millimetres, the camera, and how the camera's axes
//! stand upright.

use super::convert::timestamp;
use super::frame_names::{CAMERA, UPRIGHT};
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, Quaternion, RawImage, Vector3,
};
use linkage_driver::{PinholeCamera, RgbdFrame, jpeg};

/// Quality of JPEG.
const QUALITY: u8 = 80;
/// Depth units in a metre.
const UNITS_PER_METRE: f64 = 1000.0;

/// Colour.
pub fn color(frame: &RgbdFrame) -> Result<CompressedImage, String> {
    Ok(CompressedImage {
        timestamp: Some(timestamp(frame.utime)),
        frame_id: CAMERA.to_owned(),
        data: jpeg::encode(&frame.color, QUALITY)?.into(),
        format: "jpeg".to_owned(),
    })
}

/// Depth in millimetres; 0 where there is no reading.
pub fn depth(frame: &RgbdFrame) -> RawImage {
    let raw = frame.depth.to_raw(UNITS_PER_METRE);
    let data: Vec<u8> = raw.iter().flat_map(|z| z.to_le_bytes()).collect();
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    RawImage {
        timestamp: Some(timestamp(frame.utime)),
        frame_id: CAMERA.to_owned(),
        width: side(frame.depth.width()),
        height: side(frame.depth.height()),
        encoding: "16UC1".to_owned(),
        step: side(2 * frame.depth.width()),
        data: data.into(),
    }
}

/// The camera. Distortion is OpenCV's: Brown's five values, or eight of the rational model.
pub fn calibration(utime: i64, camera: &PinholeCamera) -> CameraCalibration {
    let PinholeCamera { fx, fy, cx, cy, distortion, .. } = *camera;
    let is_rational = distortion[5..].iter().any(|k| *k != 0.0);
    let (model, values) = if is_rational { ("rational_polynomial", 8) } else { ("plumb_bob", 5) };
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    CameraCalibration {
        timestamp: Some(timestamp(utime)),
        frame_id: CAMERA.to_owned(),
        width: side(camera.width),
        height: side(camera.height),
        distortion_model: model.to_owned(),
        d: distortion[..values].to_vec(),
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

/// The camera in a frame with x forward, y left and z up.
pub fn upright_from_camera(utime: i64) -> FrameTransform {
    FrameTransform {
        timestamp: Some(timestamp(utime)),
        parent_frame_id: UPRIGHT.to_owned(),
        child_frame_id: CAMERA.to_owned(),
        translation: Some(Vector3::default()),
        rotation: Some(Quaternion { x: -0.5, y: 0.5, z: -0.5, w: 0.5 }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Quaternion as Q, UnitQuaternion, Vector3 as V};

    #[test]
    fn the_cameras_down_is_down_where_it_stands_upright() {
        let q = upright_from_camera(0).rotation.unwrap();
        let turned = UnitQuaternion::from_quaternion(Q::new(q.w, q.x, q.y, q.z));
        assert!((turned * V::y() + V::z()).norm() < 1e-12);
        assert!((turned * V::z() - V::x()).norm() < 1e-12);
    }

    #[test]
    fn a_rational_lens_has_eight_values_and_a_plain_one_five() {
        let plain = PinholeCamera::kinect();
        let told = calibration(0, &plain);
        assert_eq!((told.distortion_model.as_str(), told.d.len()), ("plumb_bob", 5));
        let distortion = [0.1, 0.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0];
        let told = calibration(0, &PinholeCamera { distortion, ..plain });
        assert_eq!((told.distortion_model.as_str(), told.d.len()), ("rational_polynomial", 8));
    }
}
