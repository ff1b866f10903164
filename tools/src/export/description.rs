//! A learned object as links and joints, which all formats have in common.
//!
//! In: an object of the store (object frame at configuration 0, metres). Out: for each part a link,
//! with its origin on the joint that moves it and the box around its surface; for each joint its axis
//! in its parent's frame. A link's mass is that of a box of light wood: nobody weighed it.

use anyhow::bail;
use linkage_skill::object::appearance::Appearance;
use linkage_skill::object::joint_geometry::JointKind;
use linkage_skill::object::model::{Joint, ObjectModel};
use linkage_skill::store::StoredObject;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// Kilograms a cubic metre.
const DENSITY: f64 = 300.0;
/// Least mass of a link, kilograms.
const LEAST_MASS_KG: f64 = 0.05;
/// Shortest side of a box, metres.
pub const LEAST_SIDE_M: f64 = 0.005;
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
    pub fn without_screws(&self, format: &str) -> anyhow::Result<&Self> {
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

/// A joint as the formats hold it.
pub fn hinge(joint: &Joint) -> anyhow::Result<Hinge> {
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

/// A part with the box around its surface.
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
    pub fn around(surface: &[Vector3<f64>]) -> Option<Self> {
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
