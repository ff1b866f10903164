//! Intrinsics as the programs write them that make folders of pictures.

use linkage_frames::text_table;
use serde::Deserialize;

/// What a file tells of a camera; sizes and units where it does.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Intrinsics {
    /// Focal length along x, in pixels.
    pub fx: f64,
    /// Focal length along y, in pixels.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// Columns and rows of the picture that these belong to.
    pub size: Option<(usize, usize)>,
    /// Raw depth units in a metre.
    pub depth_units_per_metre: Option<f64>,
}

impl Intrinsics {
    /// Intrinsics from a matrix of `columns` columns, row by row.
    fn of_matrix(m: &[f64], columns: usize) -> Self {
        let (fy, cy) = (m[columns + 1], m[columns + 2]);
        Self { fx: m[0], fy, cx: m[2], cy, ..Self::default() }
    }

    /// The intrinsics for a picture of another size.
    pub fn scaled(&self, from: (usize, usize), to: (usize, usize)) -> Self {
        let (x, y) = (to.0 as f64 / from.0 as f64, to.1 as f64 / from.1 as f64);
        // The centre of the first pixel is (0, 0): its corner is at -0.5.
        let center = |c: f64, scale: f64| (c + 0.5) * scale - 0.5;
        let (cx, cy) = (center(self.cx, x), center(self.cy, y));
        Self { fx: self.fx * x, fy: self.fy * y, cx, cy, size: Some(to), ..*self }
    }
}

/// A matrix of 3x3, 3x4 or 4x4 numbers: `camera-intrinsics.txt`, `intrinsic_color.txt`,
/// `camera_matrix.csv`.
///
/// # Errors
/// What is wrong, in a line.
pub fn parse_matrix(text: &str) -> Result<Intrinsics, String> {
    let mut numbers = Vec::new();
    for row in text_table::rows(text) {
        numbers.extend(row.numbers().map_err(|e| format!("line {}: {e}", row.number))?);
        if numbers.len() > 16 {
            break;
        }
    }
    match numbers.len() {
        9 => Ok(Intrinsics::of_matrix(&numbers, 3)),
        12 | 16 => Ok(Intrinsics::of_matrix(&numbers, 4)),
        count => Err(format!("holds {count} numbers; a camera's matrix has 3x3 or 4x4")),
    }
}

/// Open3D's `PinholeCameraIntrinsic`, whose matrix stands column by column.
#[derive(Deserialize)]
struct Open3dFile {
    width: Option<usize>,
    height: Option<usize>,
    intrinsic_matrix: Vec<f64>,
    depth_scale: Option<f64>,
}

/// Open3D's JSON.
///
/// # Errors
/// What is wrong, in a line.
pub fn parse_open3d(text: &str) -> Result<Intrinsics, String> {
    let file: Open3dFile = serde_json::from_str(text)
        .map_err(|e| format!("{e}; expected width, height and intrinsic_matrix"))?;
    let Ok(m) = <[f64; 9]>::try_from(file.intrinsic_matrix) else {
        return Err("intrinsic_matrix must hold nine numbers".to_owned());
    };
    // Some programs write it row by row: the place of the principal point tells.
    let [cx, cy] = if m[6] == 0.0 && m[2] != 0.0 { [m[2], m[5]] } else { [m[6], m[7]] };
    let size = file.width.zip(file.height);
    let depth_units_per_metre = file.depth_scale;
    Ok(Intrinsics { fx: m[0], fy: m[4], cx, cy, size, depth_units_per_metre })
}

/// BundleFusion's `info.txt`: lines of `name = value`.
///
/// # Errors
/// What is wrong, in a line.
pub fn parse_info(text: &str) -> Result<Intrinsics, String> {
    let value = |name: &str| {
        let mut lines = text.lines().filter_map(|line| line.split_once('='));
        lines.find(|(key, _)| key.trim() == name).map(|(_, value)| value.trim())
    };
    let number = |name: &str| value(name).and_then(|v| v.parse::<f64>().ok());
    let matrix = value("m_calibrationColorIntrinsic")
        .ok_or_else(|| "has no m_calibrationColorIntrinsic".to_owned())?;
    let size = number("m_colorWidth").zip(number("m_colorHeight"));
    Ok(Intrinsics {
        size: size.map(|(width, height)| (width as usize, height as usize)),
        depth_units_per_metre: number("m_depthShift"),
        ..parse_matrix(matrix)?
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPECTED: [f64; 4] = [600.0, 610.0, 320.0, 240.0];

    fn values(i: Intrinsics) -> [f64; 4] {
        [i.fx, i.fy, i.cx, i.cy]
    }

    #[test]
    fn matrices_of_all_programs_give_the_same_camera() {
        for text in [
            "600 0 320\n0 610 240\n0 0 1\n",
            "600.0,0.0,320.0\n0.0,610.0,240.0\n0.0,0.0,1.0",
            "600 0 320 0\n0 610 240 0\n0 0 1 0\n0 0 0 1\n",
        ] {
            assert_eq!(values(parse_matrix(text).unwrap()), EXPECTED, "{text}");
        }
        for matrix in ["600,0,0, 0,610,0, 320,240,1", "600,0,320, 0,610,240, 0,0,1"] {
            let text = format!("{{\"width\":640,\"height\":480,\"intrinsic_matrix\":[{matrix}]}}");
            let read = parse_open3d(&text).unwrap();
            assert_eq!((values(read), read.size), (EXPECTED, Some((640, 480))), "{matrix}");
        }
        let info = "m_versionNumber = 4\nm_colorWidth = 640\nm_colorHeight = 480\nm_depthShift = 1000\nm_calibrationColorIntrinsic = 600 0 320 0 0 610 240 0 0 0 1 0 0 0 0 1\n";
        let read = parse_info(info).unwrap();
        assert_eq!((values(read), read.size), (EXPECTED, Some((640, 480))));
        assert_eq!(read.depth_units_per_metre, Some(1000.0));
    }

    #[test]
    fn a_smaller_picture_keeps_its_lines_of_sight() {
        let full = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5, ..Default::default() };
        let half = full.scaled((640, 480), (320, 240));
        assert_eq!(values(half), [300.0, 300.0, 159.5, 119.5]);
    }

    #[test]
    fn what_is_no_camera_is_told() {
        assert!(parse_matrix("1 2 3").unwrap_err().contains("3 numbers"));
        assert!(parse_matrix("a b c").unwrap_err().contains("line 1"));
        assert!(parse_matrix(&"1 ".repeat(5000)).is_err());
        assert!(parse_open3d("{}").unwrap_err().contains("intrinsic_matrix"));
        assert!(parse_open3d("{\"intrinsic_matrix\":[1]}").unwrap_err().contains("nine"));
        assert!(parse_info("m_depthShift = 1000").unwrap_err().contains("m_calibration"));
    }
}
