//! SDFormat, as Gazebo and Drake read it. The base is fixed to the world.

use super::cuboid::Cuboid;
use super::description::{Description, Link};
use super::joint::{Hinge, Motion};
use super::names::{legal, sdf as legal_name};
use super::xml::{document, element, spaced, text};
use quick_xml::Writer;
use std::io::{self, Write};

/// Names that the file uses itself.
const TAKEN: &[&str] = &["world", "world_to_base"];

/// The description as SDF 1.9; with screws as 1.10, which was the first to say what the pitch of one
/// is.
///
/// # Errors
/// The error of the writer.
pub fn sdf(of: &Description) -> anyhow::Result<String> {
    let of = &legal(of, legal_name, TAKEN);
    let version = if of.joints.iter().any(Hinge::is_screw) { "1.10" } else { "1.9" };
    let text = document(&of.remarks(), |writer| {
        element(writer, "sdf", &[("version", version)], |w| {
            element(w, "model", &[("name", &of.name)], |w| {
                of.links.iter().try_for_each(|l| link(w, l))?;
                let fixed = [("name", "world_to_base"), ("type", "fixed")];
                element(w, "joint", &fixed, |w| ends(w, "world", &of.links[0].name))?;
                of.joints.iter().try_for_each(|j| joint(w, of, j))
            })
        })
    })?;
    Ok(text)
}

fn link<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    element(writer, "link", &[("name", &link.name)], |w| {
        text(w, "pose", &format!("{} 0 0 0", spaced(link.origin.iter().copied())))?;
        inertial(w, link)?;
        match &link.mesh {
            None => shapes(w, link, "visual")?,
            Some(mesh) => element(w, "visual", &[("name", "visual")], |w| {
                element(w, "geometry", &[], |w| {
                    element(w, "mesh", &[], |w| text(w, "uri", &mesh.file))
                })?;
                material(w, &link.colour)
            })?,
        }
        shapes(w, link, "collision")
    })
}

/// The boxes, as visual or as collision shapes.
fn shapes<W: Write>(writer: &mut Writer<W>, link: &Link, purpose: &str) -> io::Result<()> {
    link.boxes.iter().enumerate().try_for_each(|(i, shape)| {
        element(writer, purpose, &[("name", &format!("{purpose}{}", i + 1))], |w| {
            pose(w, shape)?;
            element(w, "geometry", &[], |w| {
                let size = spaced(shape.size.iter().copied());
                element(w, "box", &[], |w| text(w, "size", &size))
            })?;
            if purpose == "visual" { material(w, &link.colour) } else { Ok(()) }
        })
    })
}

fn material<W: Write>(writer: &mut Writer<W>, [r, g, b]: &[f64; 3]) -> io::Result<()> {
    let rgba = format!("{r:.3} {g:.3} {b:.3} 1");
    element(writer, "material", &[], |w| {
        text(w, "ambient", &rgba)?;
        text(w, "diffuse", &rgba)
    })
}

fn pose<W: Write>(writer: &mut Writer<W>, shape: &Cuboid) -> io::Result<()> {
    let pose = format!("{} {}", spaced(shape.center.iter().copied()), spaced(shape.rpy()));
    text(writer, "pose", &pose)
}

fn inertial<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    element(writer, "inertial", &[], |w| {
        text(w, "pose", &format!("{} 0 0 0", spaced(link.inertia.center.iter().copied())))?;
        text(w, "mass", &link.inertia.mass_kg.to_string())?;
        element(w, "inertia", &[], |w| {
            let named = [("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1)];
            for (name, row, column) in named.into_iter().chain([("iyz", 1, 2), ("izz", 2, 2)]) {
                text(w, name, &link.inertia.moments[(row, column)].to_string())?;
            }
            Ok(())
        })
    })
}

fn ends<W: Write>(writer: &mut Writer<W>, parent: &str, child: &str) -> io::Result<()> {
    text(writer, "parent", parent)?;
    text(writer, "child", child)
}

fn joint<W: Write>(writer: &mut Writer<W>, of: &Description, joint: &Hinge) -> io::Result<()> {
    let kind = [("name", joint.name.as_str()), ("type", joint.kind())];
    element(writer, "joint", &kind, |w| {
        ends(w, &of.links[joint.parent].name, &of.links[joint.child].name)?;
        if let Motion::Screws(pitch) = joint.motion {
            text(w, "screw_thread_pitch", &pitch.to_string())?;
        }
        element(w, "axis", &[], |w| {
            text(w, "xyz", &joint.axis().map(|x| x.to_string()).join(" "))?;
            element(w, "limit", &[], |w| {
                text(w, "lower", &joint.range[0].to_string())?;
                text(w, "upper", &joint.range[1].to_string())?;
                text(w, "effort", &joint.effort.to_string())?;
                text(w, "velocity", &joint.velocity.to_string())
            })?;
            element(w, "dynamics", &[], |w| {
                text(w, "damping", &joint.damping.to_string())?;
                text(w, "friction", &joint.friction.to_string())
            })
        })
    })
}
