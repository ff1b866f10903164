//! Learned objects as robot descriptions that simulators and planners read.
//!
//! Every link's frame has the axes of the object frame, and its origin on the joint that moves
//! it; at configuration 0 the links are where the demonstration began. A link's shape is the box
//! around the surface that was seen of it, its mass that of a box of light wood: nobody weighed it.

mod mjcf;
mod sdf;
mod urdf;

pub use mjcf::mjcf;
pub use sdf::sdf;
pub use urdf::urdf;

use anyhow::bail;
use linkage_skill::object::appearance::Appearance;
use linkage_skill::object::joint_geometry::JointKind;
use linkage_skill::object::model::{Joint, ObjectModel};
use linkage_skill::store::StoredObject;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use quick_xml::Writer;
use quick_xml::events::{BytesDecl, Event};
use std::io;

/// Kilograms a cubic metre.
const DENSITY: f64 = 300.0;
const LEAST_MASS_KG: f64 = 0.05;
const LEAST_SIDE_M: f64 = 0.005;
/// Share of the surface beyond either side of a box.
const STRAYS: f64 = 0.01;

/// An object as links and joints.
pub struct Description {
    pub name: String,
    /// The root first.
    pub links: Vec<Link>,
    pub joints: Vec<Hinge>,
}

/// A part.
pub struct Link {
    pub name: String,
    /// Of its frame, in the object frame at configuration 0.
    pub origin: Point3<f64>,
    pub shape: Option<Cuboid>,
}

/// The box around a part's surface, in its link's frame.
pub struct Cuboid {
    pub center: Point3<f64>,
    pub rotation: UnitQuaternion<f64>,
    pub size: Vector3<f64>,
}

/// A joint of links that are named by their number.
pub struct Hinge {
    pub name: String,
    pub parent: usize,
    pub child: usize,
    pub motion: Motion,
    pub axis: [f64; 3],
    pub range: [f64; 2],
}

/// How a joint moves along or about its axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    Turns,
    Slides,
    /// Turns, and advances so many metres a turn.
    Screws(f64),
}

impl Hinge {
    /// What URDF and SDF call its type.
    pub fn kind(&self) -> &'static str {
        match self.motion {
            Motion::Turns => "revolute",
            Motion::Slides => "prismatic",
            Motion::Screws(_) => "screw",
        }
    }

    /// True for a screw.
    pub fn is_screw(&self) -> bool {
        matches!(self.motion, Motion::Screws(_))
    }
}

impl Description {
    /// Of a learned object.
    ///
    /// # Errors
    /// When a joint neither turns, slides nor screws, which the formats cannot hold.
    pub fn new(object: &StoredObject) -> anyhow::Result<Self> {
        let model = &object.model;
        let joints = model.joints.iter().map(hinge).collect::<anyhow::Result<_>>()?;
        let links = (0..model.parts.len()).map(|part| link(part, model, &object.appearance));
        Ok(Self { name: model.object.clone(), links: links.collect(), joints })
    }

    /// Refuses screws for a format that has none.
    ///
    /// # Errors
    /// Names the first screw.
    fn without_screws(&self, format: &str) -> anyhow::Result<&Self> {
        match self.joints.iter().find(|j| j.is_screw()) {
            None => Ok(self),
            Some(joint) => bail!(
                "{} is helical, and {format} has no screws; use --format sdf or json",
                joint.name
            ),
        }
    }

    /// Where the joint is in its parent's frame.
    pub fn in_parent(&self, joint: &Hinge) -> Vector3<f64> {
        self.links[joint.child].origin - self.links[joint.parent].origin
    }
}

fn hinge(joint: &Joint) -> anyhow::Result<Hinge> {
    let motion = match joint.kind {
        JointKind::Revolute => Motion::Turns,
        JointKind::Prismatic => Motion::Slides,
        JointKind::Helical => Motion::Screws(joint.pitch),
        other => bail!(
            "{} is {}: only joints that turn, slide or screw can be described; use --format json",
            joint.name,
            other.name()
        ),
    };
    Ok(Hinge {
        name: joint.name.clone(),
        parent: joint.parent,
        child: joint.child,
        motion,
        axis: joint.axis,
        range: joint.range,
    })
}

fn link(part: usize, model: &ObjectModel, appearance: &Appearance) -> Link {
    let moved_by = model.joints.iter().find(|j| j.child == part);
    let origin = moved_by.map_or(Point3::origin(), |j| Point3::from(j.origin));
    let surface: Vec<Vector3<f64>> = appearance
        .surfels
        .iter()
        .filter(|s| usize::from(s.part) == part)
        .map(|s| Vector3::from(s.point).map(f64::from) - origin.coords)
        .collect();
    Link { name: model.parts[part].name.clone(), origin, shape: Cuboid::around(&surface) }
}

impl Cuboid {
    /// Along the main directions of the surface; `None` with too little of it.
    fn around(surface: &[Vector3<f64>]) -> Option<Self> {
        if surface.len() < 10 {
            return None;
        }
        let mean = surface.iter().sum::<Vector3<f64>>() / surface.len() as f64;
        let spread: Matrix3<f64> =
            surface.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
        let main = spread.symmetric_eigen().eigenvectors;
        let (x, y) = (main.column(0).into_owned(), main.column(1).into_owned());
        let rotation = Rotation3::from_basis_unchecked(&[x, y, x.cross(&y)]);
        let (mut low, mut high) = (Vector3::zeros(), Vector3::zeros());
        for k in 0..3 {
            let mut along: Vec<f64> = surface.iter().map(|p| (rotation.inverse() * p)[k]).collect();
            along.sort_by(f64::total_cmp);
            let strays = (STRAYS * along.len() as f64) as usize;
            (low[k], high[k]) = (along[strays], along[along.len() - 1 - strays]);
        }
        Some(Self {
            center: Point3::from(rotation * (0.5 * (low + high))),
            rotation: UnitQuaternion::from_rotation_matrix(&rotation),
            size: (high - low).map(|side| side.max(LEAST_SIDE_M)),
        })
    }

    pub fn mass(&self) -> f64 {
        (DENSITY * self.size.product()).max(LEAST_MASS_KG)
    }

    /// Moments of inertia about the box's own axes.
    pub fn inertia(&self) -> [f64; 3] {
        let [x, y, z] = self.size.map(|side| side * side).into();
        [y + z, x + z, x + y].map(|squares| self.mass() * squares / 12.0)
    }

    /// Roll, pitch and yaw.
    pub fn rpy(&self) -> [f64; 3] {
        let (roll, pitch, yaw) = self.rotation.euler_angles();
        [roll, pitch, yaw]
    }
}

/// An indented XML document.
fn document(write: impl FnOnce(&mut Writer<Vec<u8>>) -> io::Result<()>) -> io::Result<String> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("utf-8"), None)))?;
    write(&mut writer)?;
    let mut text = writer.into_inner();
    text.push(b'\n');
    String::from_utf8(text).map_err(io::Error::other)
}

/// Numbers as the formats want them.
fn spaced(numbers: impl IntoIterator<Item = f64>) -> String {
    let text: Vec<String> = numbers.into_iter().map(|x| format!("{x:.9}")).collect();
    text.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model_joint(kind: JointKind) -> Joint {
        let value = serde_json::json!({
            "name": "latch", "parent": 0, "child": 1, "type": kind, "axis": [1.0, 0.0, 0.0],
            "origin": [0.0, 0.0, 0.0], "pitch": 0.09, "range": [0.0, 1.0], "covariance": [],
            "observations": 0, "bic": 0.0, "log_likelihood": 0.0, "position_rmse": 0.0,
            "orientation_rmse": 0.0, "configuration": [],
        });
        serde_json::from_value(value).expect("it has every field")
    }

    /// A door of 40 cm by 80 cm on a hinge, with a handle that slides upon it.
    fn cupboard() -> Description {
        let origins = [[0.0; 3], [0.2, 0.1, 1.0], [0.5, 0.1, 1.0]].map(Point3::from);
        let door: Vec<Vector3<f64>> = (0..41)
            .flat_map(|i| (0..81).map(move |k| [0.01 * f64::from(i), 0.01 * f64::from(k), 0.0]))
            .map(|p| Vector3::from(p) - Vector3::new(0.0, 0.1, 0.0))
            .collect();
        let link = |name: &str, origin, surface: &[Vector3<f64>]| Link {
            name: name.to_owned(),
            origin,
            shape: Cuboid::around(surface),
        };
        let joint = |name: &str, parent, motion, axis, range| Hinge {
            name: name.to_owned(),
            parent,
            child: parent + 1,
            motion,
            axis,
            range,
        };
        Description {
            name: "cup & board".to_owned(),
            links: vec![
                link("base", origins[0], &[]),
                link("door", origins[1], &door),
                link("handle", origins[2], &[]),
            ],
            joints: vec![
                joint("hinge", 0, Motion::Turns, [0.0, 1.0, 0.0], [0.0, 1.5]),
                joint("latch", 1, Motion::Slides, [1.0, 0.0, 0.0], [-0.1, 0.0]),
            ],
        }
    }

    #[test]
    fn a_reader_of_urdf_finds_the_joints_where_they_were_learned() {
        let description = cupboard();
        let robot = urdf_rs::read_from_string(&urdf(&description).unwrap()).unwrap();
        assert_eq!((robot.name.as_str(), robot.links.len()), ("cup & board", 3));
        let mut at = Vector3::zeros();
        for (read, written) in robot.joints.iter().zip(&description.joints) {
            at += Vector3::from(*read.origin.xyz);
            let child = &description.links[written.child];
            assert!((at - child.origin.coords).norm() < 1e-8, "{}", written.name);
            assert_eq!(*read.axis.xyz, written.axis);
            assert_eq!([read.limit.lower, read.limit.upper], written.range);
            assert_eq!(read.child.link, child.name);
        }
        assert!(matches!(robot.joints[0].joint_type, urdf_rs::JointType::Revolute));
        assert!(matches!(robot.joints[1].joint_type, urdf_rs::JointType::Prismatic));
    }

    #[test]
    fn the_box_is_the_surface_s() {
        let description = cupboard();
        let shape = description.links[1].shape.as_ref().unwrap();
        let mut sides: Vec<f64> = shape.size.iter().copied().collect();
        sides.sort_by(f64::total_cmp);
        for (side, wanted) in sides.iter().zip([LEAST_SIDE_M, 0.4, 0.8]) {
            assert!((side - wanted).abs() < 0.03, "{sides:?}");
        }
        assert!((shape.center - Point3::new(0.2, 0.3, 0.0)).norm() < 0.02);
        assert!(description.links[0].shape.is_none());
    }

    #[test]
    fn mjcf_nests_what_moves_with_what_and_sdf_places_every_link() {
        let text = mjcf(&cupboard()).unwrap();
        let place = |what: &str| text.find(what).unwrap_or_else(|| panic!("{what} in {text}"));
        let order = ["body name=\"base\"", "body name=\"door\"", "body name=\"handle\"", "</body>"];
        assert!(order.windows(2).all(|w| place(w[0]) < place(w[1])), "{text}");
        assert!(text.contains("type=\"slide\"") && text.contains("model=\"cup &amp; board\""));
        let text = sdf(&cupboard()).unwrap();
        assert!(text.contains("<pose>0.200000000 0.100000000 1.000000000 0 0 0</pose>"), "{text}");
    }

    #[test]
    fn a_screw_is_written_where_the_format_has_screws_and_refused_by_name_elsewhere() {
        let screw = hinge(&model_joint(JointKind::Helical)).unwrap();
        let (parent, child) = (1, 2);
        let description = Description {
            joints: vec![cupboard().joints.swap_remove(0), Hinge { parent, child, ..screw }],
            ..cupboard()
        };
        let text = sdf(&description).unwrap();
        for wanted in ["version=\"1.10\"", "type=\"screw\"", "<screw_thread_pitch>0.09<"] {
            assert!(text.contains(wanted), "{wanted} in {text}");
        }
        for refused in [urdf(&description), mjcf(&description)] {
            assert!(refused.unwrap_err().to_string().contains("latch is helical"));
        }
    }

    #[test]
    fn a_joint_that_no_format_can_hold_is_refused_by_name() {
        let refused = hinge(&model_joint(JointKind::Nonparametric)).err().unwrap().to_string();
        assert!(refused.contains("latch is nonparametric"), "{refused}");
    }
}
