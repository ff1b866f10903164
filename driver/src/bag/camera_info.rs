//! The camera that `sensor_msgs/CameraInfo` describes.

use super::messages::CameraInfo;
use linkage_frames::camera::PinholeCamera;
use linkage_frames::depth::DepthSensor;

/// Names of the polynomial model, whose five coefficients are `k1 k2 p1 p2 k3`.
const POLYNOMIAL: [&str; 4] = ["plumb_bob", "brown conrady", "brown_conrady", "brown-conrady"];
/// Names of the rational model, with `k4 k5 k6` behind those.
const RATIONAL: [&str; 2] = ["rational_polynomial", "rational polynomial"];

/// The camera of a topic's pictures, whose depth has this many units in a metre. The pictures of a
/// rectified topic have the intrinsics `P` and no distortion.
///
/// # Errors
/// What is wrong, in a line: a model of distortion that is not read, binning, or values that no
/// camera has.
pub fn camera_of(
    info: &CameraInfo,
    is_rectified: bool,
    units_per_metre: f64,
) -> Result<PinholeCamera, String> {
    if info.binning.iter().any(|b| *b > 1) {
        return Err(format!(
            "its pixels are binned {}x{}, which is not read; describe the camera of the binned pictures with --camera camera.toml",
            info.binning[0], info.binning[1]
        ));
    }
    let [fx, cx, fy, cy] = if is_rectified && info.p[0] > 0.0 {
        [info.p[0], info.p[2], info.p[5], info.p[6]]
    } else {
        [info.k[0], info.k[2], info.k[4], info.k[5]]
    };
    let camera = PinholeCamera {
        width: info.width,
        height: info.height,
        fx,
        fy,
        cx,
        cy,
        depth_units_per_metre: units_per_metre,
        distortion: if is_rectified { [0.0; 8] } else { distortion(info)? },
        depth_sensor: DepthSensor::default(),
    };
    camera.check().map_err(|e| e.to_string())?;
    Ok(camera)
}

/// OpenCV's `k1 k2 p1 p2 k3 k4 k5 k6`.
fn distortion(info: &CameraInfo) -> Result<[f64; 8], String> {
    if info.d.iter().all(|d| *d == 0.0) {
        return Ok([0.0; 8]);
    }
    let model = info.distortion_model.to_ascii_lowercase();
    let count = if POLYNOMIAL.contains(&model.as_str()) {
        5
    } else if RATIONAL.contains(&model.as_str()) {
        8
    } else {
        return Err(format!(
            "its distortion model \"{}\" is not read; plumb_bob and rational_polynomial are: undistort the pictures, or describe the camera with --camera camera.toml",
            info.distortion_model
        ));
    };
    if info.d.iter().skip(count).any(|d| *d != 0.0) {
        return Err(format!(
            "its distortion model \"{}\" has {} coefficients, of which {count} are read",
            info.distortion_model,
            info.d.len()
        ));
    }
    let mut distortion = [0.0; 8];
    for (to, from) in distortion.iter_mut().zip(info.d.iter().take(count)) {
        *to = *from;
    }
    Ok(distortion)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info(model: &str, d: &[f64]) -> CameraInfo {
        CameraInfo {
            frame: "optical".to_owned(),
            width: 640,
            height: 480,
            distortion_model: model.to_owned(),
            d: d.to_vec(),
            k: [600.0, 0.0, 320.0, 0.0, 610.0, 240.0, 0.0, 0.0, 1.0],
            p: [590.0, 0.0, 318.0, 0.0, 0.0, 591.0, 238.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            binning: [0, 0],
        }
    }

    #[test]
    fn plumb_bob_is_opencvs_order() {
        let camera =
            camera_of(&info("plumb_bob", &[0.1, -0.2, 0.001, 0.002, 0.05]), false, 1000.0).unwrap();
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (600.0, 610.0, 320.0, 240.0));
        assert_eq!(camera.distortion, [0.1, -0.2, 0.001, 0.002, 0.05, 0.0, 0.0, 0.0]);
        assert_eq!(camera.depth_units_per_metre, 1000.0);
    }

    #[test]
    fn a_rectified_picture_has_the_intrinsics_p_and_no_distortion() {
        let camera = camera_of(&info("plumb_bob", &[0.1; 5]), true, 1000.0).unwrap();
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (590.0, 591.0, 318.0, 238.0));
        assert_eq!(camera.distortion, [0.0; 8]);
    }

    #[test]
    fn other_models_are_refused_by_name_unless_they_do_nothing() {
        for model in ["equidistant", "Inverse Brown Conrady", "thin_prism"] {
            let error = camera_of(&info(model, &[0.01; 4]), false, 1000.0).unwrap_err();
            assert!(error.contains(model) && error.contains("plumb_bob"), "{error}");
            assert!(camera_of(&info(model, &[0.0; 5]), false, 1000.0).is_ok());
        }
        let error = camera_of(&info("rational_polynomial", &[0.01; 12]), false, 1000.0);
        assert!(error.unwrap_err().contains("12 coefficients"));
    }

    #[test]
    fn binning_and_values_of_no_camera_are_refused() {
        let binned = CameraInfo { binning: [2, 2], ..info("", &[]) };
        assert!(camera_of(&binned, false, 1000.0).unwrap_err().contains("binned 2x2"));
        let empty = CameraInfo { k: [0.0; 9], ..info("", &[]) };
        assert!(camera_of(&empty, false, 1000.0).unwrap_err().contains("fx is 0"));
    }
}
