//! Which column of a pose log holds what, by the names of the columns or by their number.

use super::table::Value;
use std::str::FromStr;

/// Where the values of a pose stand in a row.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    /// Columns of a row.
    pub count: usize,
    /// Time; the row's number where there is none.
    pub time: Option<TimeColumn>,
    /// x, y, z, and what turns each into metres.
    pub position: [(usize, f64); 3],
    /// qx, qy, qz, qw.
    pub orientation: Option<[usize; 4]>,
}

/// Where the time stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeColumn {
    /// Its column.
    pub index: usize,
    /// What turns it into seconds; `None`: told by its size.
    pub scale: Option<f64>,
    /// Column of nanoseconds that are added (ROS writes seconds and nanoseconds apart).
    pub nanoseconds: Option<usize>,
}

/// What `--columns` and the messages say of names.
pub const KNOWN_NAMES: &str = "t, x, y, z, qx, qy, qz, qw, and _ for a column that is not used";

/// What a column's name says that it holds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Role {
    Time {
        scale: Option<f64>,
        is_stamp: bool,
    },
    /// 0 for x, 1 for y, 2 for z.
    Position {
        axis: usize,
        scale: f64,
        is_plain: bool,
    },
    /// 0 to 3 for x, y, z, w.
    Orientation {
        axis: usize,
    },
}

impl FromStr for Columns {
    type Err = String;

    /// Reads `t,x,y,z,qx,qy,qz,qw,_`: one name a column.
    fn from_str(text: &str) -> Result<Self, String> {
        let names: Vec<&str> = text.split(',').map(str::trim).collect();
        let is_unused = |name: &str| name.is_empty() || name.chars().all(|c| c == '_');
        if let Some(name) = names.iter().find(|n| !is_unused(n) && role_of(n).is_none()) {
            return Err(format!("\"{name}\" is no known column; known are {KNOWN_NAMES}"));
        }
        Self::from_names(&names)
    }
}

impl Columns {
    /// The columns that a header names.
    ///
    /// # Errors
    /// Says which names are missing, or which columns hold the same.
    pub fn from_names(names: &[&str]) -> Result<Self, String> {
        let roles: Vec<Option<Role>> = names.iter().map(|n| role_of(n)).collect();
        let mut position = [(0, 1.0); 3];
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            position[axis] = position_column(&roles, axis, name)?;
        }
        Ok(Self {
            count: names.len(),
            time: time_column(names, &roles),
            position,
            orientation: orientation_columns(&roles)?,
        })
    }

    /// True where a row of words names at least a position: a header.
    pub fn are_named_by(names: &[&str]) -> bool {
        let roles: Vec<Option<Role>> = names.iter().map(|n| role_of(n)).collect();
        (0..3).all(|wanted| {
            roles.iter().any(|r| matches!(r, Some(Role::Position { axis, .. }) if *axis == wanted))
        })
    }

    /// The columns of a log without names, by how many there are.
    ///
    /// # Errors
    /// Says which numbers of columns are known, and how to name others.
    pub fn from_count(count: usize) -> Result<Self, String> {
        let layout = |first: usize, has_time: bool, has_orientation: bool| Self {
            count,
            time: has_time.then_some(TimeColumn { index: 0, scale: None, nanoseconds: None }),
            position: [0, 1, 2].map(|axis| (first + axis, 1.0)),
            orientation: has_orientation.then(|| [3, 4, 5, 6].map(|i| first + i)),
        };
        match count {
            3 | 5 => Ok(layout(0, false, false)),
            7 | 9 => Ok(layout(0, false, true)),
            8 => Ok(layout(1, true, true)),
            n => Err(format!("{n} columns without names; {}", how_to_name(n))),
        }
    }

    /// The name of each column, for messages.
    pub fn names(&self) -> String {
        let mut names = vec!["_"; self.count];
        if let Some(time) = self.time {
            names[time.index] = "t";
        }
        for ((index, _), name) in self.position.iter().zip(["x", "y", "z"]) {
            names[*index] = name;
        }
        for (index, name) in self.orientation.iter().flatten().zip(["qx", "qy", "qz", "qw"]) {
            names[*index] = name;
        }
        names.join(",")
    }
}

/// What to do where columns cannot be told.
pub fn how_to_name(count: usize) -> String {
    let known = "known without names are x y z, x y z qx qy qz qw, t x y z qx qy qz qw, and each \
                 of the first two with width height behind it";
    let mut example = vec!["t", "x", "y", "z", "qx", "qy", "qz", "qw"];
    example.resize(count.max(3), "_");
    let example = if count < 7 { "x,y,z".to_owned() } else { example.join(",") };
    format!("{known}. Name them in a first line or with --columns, for example --columns {example}")
}

fn position_column(
    roles: &[Option<Role>],
    wanted: usize,
    name: &str,
) -> Result<(usize, f64), String> {
    let of = |only_plain: bool| -> Vec<(usize, f64)> {
        let matching = |(i, role): (usize, &Option<Role>)| match *role {
            Some(Role::Position { axis, scale, is_plain })
                if axis == wanted && (is_plain || !only_plain) =>
            {
                Some((i, scale))
            }
            _ => None,
        };
        roles.iter().enumerate().filter_map(matching).collect()
    };
    let plain = of(true);
    let found = if plain.is_empty() { of(false) } else { plain };
    match found[..] {
        [one] => Ok(one),
        [] => Err(format!("no column is named {name}")),
        [(a, _), (b, _), ..] => {
            Err(format!("columns {} and {} both are named {name}", a + 1, b + 1))
        }
    }
}

fn orientation_columns(roles: &[Option<Role>]) -> Result<Option<[usize; 4]>, String> {
    const NAMES: [&str; 4] = ["qx", "qy", "qz", "qw"];
    let of = |wanted: usize| -> Vec<usize> {
        let is_it = |role: &Option<Role>| *role == Some(Role::Orientation { axis: wanted });
        (0..roles.len()).filter(|&i| is_it(&roles[i])).collect()
    };
    let found: [Vec<usize>; 4] = [0, 1, 2, 3].map(of);
    if found.iter().all(Vec::is_empty) {
        return Ok(None);
    }
    let mut columns = [0; 4];
    for ((column, found), name) in columns.iter_mut().zip(&found).zip(NAMES) {
        *column = match found[..] {
            [one] => one,
            [] => {
                return Err(format!("no column is named {name}, while others of qx qy qz qw are"));
            }
            [a, b, ..] => {
                return Err(format!("columns {} and {} both are named {name}", a + 1, b + 1));
            }
        };
    }
    Ok(Some(columns))
}

/// The time: a stamp before other times (a bag's `%time` is when a message was written), and
/// nanoseconds beside seconds of the same name.
fn time_column(names: &[&str], roles: &[Option<Role>]) -> Option<TimeColumn> {
    let times: Vec<(usize, Option<f64>, bool)> = (0..roles.len())
        .filter_map(|i| match roles[i] {
            Some(Role::Time { scale, is_stamp }) => Some((i, scale, is_stamp)),
            _ => None,
        })
        .collect();
    let &(index, scale, _) = times.iter().find(|(.., stamp)| *stamp).or(times.first())?;
    let prefix = |i: usize| {
        let (words, _) = words_of(names[i]);
        words[..words.len().saturating_sub(1)].join(".")
    };
    let apart = |&&(i, other, _): &&(usize, Option<f64>, bool)| {
        i != index && scale == Some(1.0) && other == Some(1e-9) && prefix(i) == prefix(index)
    };
    let nanoseconds = times.iter().find(apart).map(|(i, ..)| *i);
    Some(TimeColumn { index, scale, nanoseconds })
}

/// Words in names of columns that hold no position, orientation or time.
const OF_OTHER_THINGS: [&str; 24] = [
    "velocity",
    "vel",
    "twist",
    "linear",
    "angular",
    "accel",
    "acceleration",
    "covariance",
    "cov",
    "euler",
    "rpy",
    "force",
    "torque",
    "normal",
    "size",
    "pixel",
    "color",
    "colour",
    "gyro",
    "acc",
    "v",
    "b",
    "a",
    "omega",
];
/// Words in names of columns that hold an orientation.
const OF_ORIENTATION: [&str; 9] =
    ["orientation", "rotation", "quaternion", "quat", "q", "rot", "ori", "orient", "attitude"];

/// What a name says, whichever of the common ways it is written: `qx`, `q_x`, `rotation.x`,
/// `field.pose.orientation.x`, `q_RS_x []`, `timestamp [ns]`, `posX`, `utime`.
fn role_of(name: &str) -> Option<Role> {
    let (words, unit) = words_of(name);
    let (last, context) = words.split_last()?;
    if words.iter().any(|w| OF_OTHER_THINGS.contains(&w.as_str())) {
        return None;
    }
    if let Some(role) = time_role(last, context, unit.as_deref()) {
        return Some(role);
    }
    let is_any_of = |known: &[&str]| context.iter().any(|w| known.contains(&w.as_str()));
    let turned = is_any_of(&OF_ORIENTATION);
    let axis_of = |letter: &str| ["x", "y", "z", "w"].iter().position(|a| *a == letter);
    if let Some(letter) = ["quat", "q", "rot"].iter().find_map(|p| last.strip_prefix(p))
        && let Some(axis) = axis_of(letter)
    {
        return Some(Role::Orientation { axis });
    }
    let scale = match unit.as_deref() {
        None | Some("m" | "metre" | "metres" | "meter" | "meters") => 1.0,
        Some("mm") => 1e-3,
        Some("cm") => 1e-2,
        Some(_) if turned => 1.0,
        Some(_) => return None,
    };
    let glued = ["pos", "p", "t"].iter().find_map(|p| axis_of(last.strip_prefix(p)?));
    let is_plain = context.is_empty()
        || is_any_of(&["position", "translation", "trans", "pos", "p", "t", "point", "location"]);
    match (axis_of(last), glued) {
        (Some(axis), _) if turned => Some(Role::Orientation { axis }),
        (Some(axis @ 0..=2), _) => Some(Role::Position { axis, scale, is_plain }),
        (_, Some(axis @ 0..=2)) => Some(Role::Position { axis, scale, is_plain: true }),
        _ => None,
    }
}

fn time_role(last: &str, context: &[String], unit: Option<&str>) -> Option<Role> {
    let seconds = |unit: &str| match unit {
        "s" | "sec" | "secs" | "second" | "seconds" => Some(1.0),
        "ms" | "msec" | "msecs" | "millis" | "milliseconds" => Some(1e-3),
        "us" | "µs" | "usec" | "usecs" | "micros" | "microseconds" => Some(1e-6),
        "ns" | "nsec" | "nsecs" | "nanos" | "nanosec" | "nanosecs" | "nanoseconds" => Some(1e-9),
        _ => None,
    };
    const TIMES: [&str; 5] = ["t", "time", "timestamp", "stamp", "elapsed"];
    let is_stamp = last.contains("stamp") || context.iter().any(|w| w.contains("stamp"));
    if last == "utime" {
        return Some(Role::Time { scale: Some(1e-6), is_stamp });
    }
    if TIMES.contains(&last) {
        let scale = match unit {
            Some(unit) => Some(seconds(unit)?),
            None => None,
        };
        return Some(Role::Time { scale, is_stamp });
    }
    // `header.stamp.secs`, `sec`.
    let scale = seconds(last).filter(|_| last.len() > 2)?;
    Some(Role::Time { scale: Some(scale), is_stamp })
}

/// The words of a name, in lower case, and the unit that it ends with: in brackets (`x [mm]`) or
/// as its last word (`time_ns`, `x_mm`).
fn words_of(name: &str) -> (Vec<String>, Option<String>) {
    let (name, bracketed) = match name.split_once(['[', '(']) {
        Some((before, behind)) => {
            let unit = behind.split([']', ')']).next().unwrap_or_default().trim().to_lowercase();
            (before, (!unit.is_empty()).then_some(unit))
        }
        None => (name, None),
    };
    let mut spaced = String::new();
    let mut before = ' ';
    for c in name.chars() {
        if before.is_lowercase() && c.is_uppercase() {
            spaced.push(' ');
        }
        spaced.extend(c.to_lowercase());
        before = c;
    }
    let mut words: Vec<String> = spaced
        .split(|c: char| !c.is_alphanumeric())
        .filter(|w| !w.is_empty())
        .map(String::from)
        .collect();
    const UNITS: [&str; 8] = ["s", "ms", "us", "ns", "m", "mm", "cm", "µs"];
    if bracketed.is_none()
        && words.len() > 1
        && words.last().is_some_and(|w| UNITS.contains(&w.as_str()))
    {
        let unit = words.pop();
        return (words, unit);
    }
    (words, bracketed)
}

/// True where a row holds a word that is no number: it may be a header.
pub fn has_words(fields: &[impl AsRef<str>]) -> bool {
    fields.iter().any(|f| Value::of(f.as_ref()) == Value::Word)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(header: &str) -> Columns {
        let names: Vec<&str> = header.split(',').collect();
        Columns::from_names(&names).unwrap()
    }

    #[test]
    fn common_headers_are_told_by_their_names() {
        for header in [
            "timestamp,x,y,z,qx,qy,qz,qw",
            "t,tx,ty,tz,q_x,q_y,q_z,q_w",
            "time,px,py,pz,rotation.x,rotation.y,rotation.z,rotation.w",
            "Time,PosX,PosY,PosZ,RotX,RotY,RotZ,RotW",
            "stamp,position/x,position/y,position/z,quat_x,quat_y,quat_z,quat_w",
            "utime,pos_x,pos_y,pos_z,orientation_x,orientation_y,orientation_z,orientation_w",
        ] {
            let columns = read(header);
            assert_eq!(columns.names(), "t,x,y,z,qx,qy,qz,qw", "{header}");
        }
    }

    #[test]
    fn the_scalar_of_a_quaternion_may_come_first() {
        let columns = read(
            "timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],\
             q_RS_z [],v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1]",
        );
        assert_eq!(columns.names(), "t,x,y,z,qw,qx,qy,qz,_,_,_");
        assert_eq!(columns.time.unwrap().scale, Some(1e-9));
    }

    #[test]
    fn a_bag_is_read_by_its_stamp_and_its_pose() {
        let columns = read(
            "time,field.header.seq,field.header.stamp,field.header.frame_id,\
             field.pose.position.x,field.pose.position.y,field.pose.position.z,\
             field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,\
             field.pose.orientation.w",
        );
        assert_eq!(columns.names(), "_,_,t,_,x,y,z,qx,qy,qz,qw");
        let columns = read(
            "header.stamp.sec,header.stamp.nanosec,pose.position.x,pose.position.y,pose.position.z,twist.linear.x",
        );
        let time = columns.time.unwrap();
        assert_eq!((time.index, time.nanoseconds), (0, Some(1)));
    }

    #[test]
    fn units_in_names_are_obeyed() {
        let columns = read("time_ms,x_mm,y [mm],z (mm)");
        assert_eq!(columns.time.unwrap().scale, Some(1e-3));
        assert_eq!(columns.position, [(1, 1e-3), (2, 1e-3), (3, 1e-3)]);
    }

    #[test]
    fn what_cannot_be_told_is_refused() {
        for (names, word) in [
            (&["t", "x", "y"][..], "named z"),
            (&["x", "y", "z", "x"], "columns 1 and 4"),
            (&["x", "y", "z", "qx", "qy", "qz"], "named qw"),
            (&["x", "y", "z", "qx", "qy", "qz", "w"], "named qw"),
        ] {
            let message = Columns::from_names(names).unwrap_err();
            assert!(message.contains(word), "{message}");
        }
        for count in [1, 2, 4, 6, 10, 16] {
            let message = Columns::from_count(count).unwrap_err();
            assert!(message.contains("--columns"), "{message}");
        }
    }

    #[test]
    fn the_option_takes_known_names_alone() {
        let columns: Columns = "_,t,x,y,z,qw,qx,qy,qz".parse().unwrap();
        assert_eq!(columns.names(), "_,t,x,y,z,qw,qx,qy,qz");
        let message = "t,x,y,z,roll".parse::<Columns>().unwrap_err();
        assert!(message.contains("\"roll\"") && message.contains("qx"), "{message}");
    }
}
