//! Logs of one moving part's poses: a line a sample.
//!
//! `x y z`, `x y z width height` (a tracked rectangle), `x y z qx qy qz qw`, the same with
//! `width height` behind it, or TUM's `t x y z qx qy qz qw`; metres, `#` comments.

use super::{FitError, PoseSample};
use nalgebra::{Point3, Quaternion, UnitQuaternion};
use std::path::Path;

/// A log that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PoseLogError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The log.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A line that is no sample.
    #[error("{path}: line {line}: {reason}")]
    Line {
        /// The log.
        path: String,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// No joint can be fitted to it.
    #[error("{path}: {source}")]
    Fit {
        /// The log.
        path: String,
        /// Why.
        source: FitError,
    },
}

/// Reads a pose log.
///
/// # Errors
/// [`PoseLogError`] names the file and the line: unreadable numbers, NaN, a changing number
/// of columns, a quaternion of no length, time running backwards.
pub fn read_pose_log(path: &Path) -> Result<Vec<PoseSample>, PoseLogError> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path)
        .map_err(|source| PoseLogError::Read { path: name.clone(), source })?;
    let mut samples: Vec<PoseSample> = Vec::new();
    let mut columns = None;
    for (i, line) in text.lines().enumerate() {
        let fail = |reason: String| PoseLogError::Line { path: name.clone(), line: i + 1, reason };
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let values = line
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|w| !w.is_empty())
            .map(|w| match w.parse::<f64>() {
                Ok(x) if x.is_finite() => Ok(x),
                _ => Err(fail(format!("\"{w}\" is no finite number; remove or repair the line"))),
            })
            .collect::<Result<Vec<f64>, _>>()?;
        if *columns.get_or_insert(values.len()) != values.len() {
            return Err(fail(format!(
                "{} columns, the lines before have {}",
                values.len(),
                columns.unwrap_or(0)
            )));
        }
        let sample = parse_sample(&values, samples.len()).map_err(fail)?;
        if let Some(before) = samples.last()
            && sample.t <= before.t
        {
            return Err(fail(format!("time runs backwards ({} after {})", sample.t, before.t)));
        }
        samples.push(sample);
    }
    Ok(samples)
}

fn parse_sample(values: &[f64], number: usize) -> Result<PoseSample, String> {
    let (t, pose, quaternion) = match values.len() {
        3 | 5 => (number as f64, &values[..3], None),
        7 | 9 => (number as f64, &values[..3], Some(&values[3..7])),
        8 => (values[0], &values[1..4], Some(&values[4..8])),
        n => {
            return Err(format!(
                "{n} columns; expected x y z, x y z qx qy qz qw, or t x y z qx qy qz qw"
            ));
        }
    };
    let orientation = match quaternion {
        None => None,
        Some(q) => {
            let q = Quaternion::new(q[3], q[0], q[1], q[2]);
            if q.norm() < 1e-6 {
                return Err("the quaternion has no length".to_owned());
            }
            Some(UnitQuaternion::from_quaternion(q))
        }
    };
    Ok(PoseSample { t, position: Point3::new(pose[0], pose[1], pose[2]), orientation })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<PoseSample>, PoseLogError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_pose_log(file.path())
    }

    #[test]
    fn nan_is_refused_with_file_and_line() {
        let message = read("0 0 0\n0.1 nan 0\n").unwrap_err().to_string();
        assert!(message.contains("line 2") && message.contains("nan"), "{message}");
    }

    #[test]
    fn tum_lines_carry_their_time() {
        let samples = read("1.5 1 2 3 0 0 0 1\n1.6 1 2 3 0 0 0 1\n").unwrap();
        assert_eq!(samples[1].t, 1.6);
        assert_eq!(samples[1].position, Point3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn time_running_backwards_is_refused() {
        let message = read("2 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n").unwrap_err().to_string();
        assert!(message.contains("backwards"), "{message}");
    }
}
