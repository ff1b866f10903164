//! URDF, as ROS, Drake, PyBullet and MuJoCo read it.
//!
//! A link `world` without mass carries the base: readers fix it, and some refuse a base with mass.

use super::cuboid::Cuboid;
use super::description::{Description, Link};
use super::joint::Hinge;
use super::names::{legal, plain};
use super::xml::{document, element, empty, spaced};
use quick_xml::Writer;
use std::io::{self, Write};

/// Names that the file uses itself.
const TAKEN: &[&str] = &["world", "world_to_base"];

/// The description as URDF.
///
/// # Errors
/// For screws, which it has not.
pub fn urdf(of: &Description) -> anyhow::Result<String> {
    let of = &legal(of.without_screws("URDF")?, plain, TAKEN);
    let text = document(&of.remarks(), |writer| {
        element(writer, "robot", &[("name", &of.name)], |w| {
            empty(w, "link", &[("name", "world")])?;
            of.links.iter().try_for_each(|l| link(w, l))?;
            let fixed = [("name", "world_to_base"), ("type", "fixed")];
            element(w, "joint", &fixed, |w| ends(w, "world", &of.links[0].name))?;
            of.joints.iter().try_for_each(|j| joint(w, of, j))
        })
    })?;
    Ok(text)
}

fn link<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    element(writer, "link", &[("name", &link.name)], |w| {
        inertial(w, link)?;
        match &link.mesh {
            None => link.boxes.iter().try_for_each(|b| visual_box(w, b, &link.colour))?,
            Some(mesh) => element(w, "visual", &[], |w| {
                element(w, "geometry", &[], |w| empty(w, "mesh", &[("filename", &mesh.file)]))?;
                material(w, &link.colour)
            })?,
        }
        link.boxes.iter().try_for_each(|b| element(w, "collision", &[], |w| geometry(w, b)))
    })
}

fn inertial<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    element(writer, "inertial", &[], |w| {
        let center = spaced(link.inertia.center.iter().copied());
        empty(w, "origin", &[("xyz", &center), ("rpy", "0 0 0")])?;
        empty(w, "mass", &[("value", &link.inertia.mass_kg.to_string())])?;
        let i = link.inertia.moments.map(|x| x.to_string());
        let [xx, yy, zz] = [0, 1, 2].map(|k| i[(k, k)].as_str());
        let [xy, xz, yz] = [(0, 1), (0, 2), (1, 2)].map(|k| i[k].as_str());
        let moments =
            [("ixx", xx), ("ixy", xy), ("ixz", xz), ("iyy", yy), ("iyz", yz), ("izz", zz)];
        empty(w, "inertia", &moments)
    })
}

fn visual_box<W: Write>(w: &mut Writer<W>, shape: &Cuboid, colour: &[f64; 3]) -> io::Result<()> {
    element(w, "visual", &[], |w| {
        geometry(w, shape)?;
        material(w, colour)
    })
}

fn material<W: Write>(writer: &mut Writer<W>, [r, g, b]: &[f64; 3]) -> io::Result<()> {
    let rgba = format!("{r:.3} {g:.3} {b:.3} 1");
    let name = format!("rgb {r:.3} {g:.3} {b:.3}");
    element(writer, "material", &[("name", &name)], |w| empty(w, "color", &[("rgba", &rgba)]))
}

fn geometry<W: Write>(writer: &mut Writer<W>, shape: &Cuboid) -> io::Result<()> {
    let (xyz, rpy) = (spaced(shape.center.iter().copied()), spaced(shape.rpy()));
    empty(writer, "origin", &[("xyz", &xyz), ("rpy", &rpy)])?;
    let size = spaced(shape.size.iter().copied());
    element(writer, "geometry", &[], |w| empty(w, "box", &[("size", &size)]))
}

fn ends<W: Write>(writer: &mut Writer<W>, parent: &str, child: &str) -> io::Result<()> {
    empty(writer, "parent", &[("link", parent)])?;
    empty(writer, "child", &[("link", child)])
}

fn joint<W: Write>(writer: &mut Writer<W>, of: &Description, joint: &Hinge) -> io::Result<()> {
    let kind = [("name", joint.name.as_str()), ("type", joint.kind())];
    element(writer, "joint", &kind, |w| {
        ends(w, &of.links[joint.parent].name, &of.links[joint.child].name)?;
        let at = spaced(of.in_parent(joint).iter().copied());
        empty(w, "origin", &[("xyz", &at), ("rpy", "0 0 0")])?;
        empty(w, "axis", &[("xyz", &joint.axis().map(|x| x.to_string()).join(" "))])?;
        let [lower, upper] = joint.range.map(|q| q.to_string());
        let (effort, velocity) = (joint.effort.to_string(), joint.velocity.to_string());
        let limit = [
            ("lower", lower.as_str()),
            ("upper", &upper),
            ("effort", &effort),
            ("velocity", &velocity),
        ];
        empty(w, "limit", &limit)?;
        // Drake warns of dry friction in URDF, so that a guess is not worth it.
        let friction = joint.given.friction.unwrap_or(0.0).to_string();
        empty(w, "dynamics", &[("damping", &joint.damping.to_string()), ("friction", &friction)])
    })
}
