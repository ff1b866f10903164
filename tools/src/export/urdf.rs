//! URDF, as ROS and Drake read it.

use super::description::{Cuboid, Description, Hinge, Link};
use super::xml::{document, spaced};
use quick_xml::Writer;
use std::io::{self, Write};

/// Newton or newton metres, and radians or metres a second: the format wants limits.
const EFFORT: &str = "100";
const VELOCITY: &str = "1";

/// The description as URDF.
///
/// # Errors
/// For screws, which it has not.
pub fn urdf(of: &Description) -> anyhow::Result<String> {
    let of = of.without_screws("URDF")?;
    let text = document(|writer| {
        writer
            .create_element("robot")
            .with_attribute(("name", of.name.as_str()))
            .write_inner_content(|w| {
                of.links.iter().try_for_each(|l| link(w, l))?;
                of.joints.iter().try_for_each(|j| joint(w, of, j))
            })
            .map(drop)
    })?;
    Ok(text)
}

fn link<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    let element = writer.create_element("link").with_attribute(("name", link.name.as_str()));
    let Some(shape) = &link.shape else { return element.write_empty().map(drop) };
    element
        .write_inner_content(|w| {
            w.create_element("inertial").write_inner_content(|w| {
                origin(w, shape)?;
                let mass = shape.mass().to_string();
                w.create_element("mass").with_attribute(("value", mass.as_str())).write_empty()?;
                let [x, y, z] = shape.inertia().map(|i| i.to_string());
                w.create_element("inertia")
                    .with_attributes([("ixx", x.as_str()), ("iyy", &y), ("izz", &z)])
                    .with_attributes([("ixy", "0"), ("ixz", "0"), ("iyz", "0")])
                    .write_empty()?;
                Ok(())
            })?;
            for purpose in ["visual", "collision"] {
                w.create_element(purpose).write_inner_content(|w| {
                    origin(w, shape)?;
                    w.create_element("geometry").write_inner_content(|w| {
                        let size = spaced(shape.size.iter().copied());
                        w.create_element("box")
                            .with_attribute(("size", size.as_str()))
                            .write_empty()
                            .map(drop)
                    })?;
                    Ok(())
                })?;
            }
            Ok(())
        })
        .map(drop)
}

fn origin<W: Write>(writer: &mut Writer<W>, shape: &Cuboid) -> io::Result<()> {
    let (xyz, rpy) = (spaced(shape.center.iter().copied()), spaced(shape.rpy()));
    let attributes = [("xyz", xyz.as_str()), ("rpy", rpy.as_str())];
    writer.create_element("origin").with_attributes(attributes).write_empty().map(drop)
}

fn joint<W: Write>(writer: &mut Writer<W>, of: &Description, joint: &Hinge) -> io::Result<()> {
    writer
        .create_element("joint")
        .with_attributes([("name", joint.name.as_str()), ("type", joint.kind())])
        .write_inner_content(|w| {
            for (role, link) in [("parent", joint.parent), ("child", joint.child)] {
                let name = of.links[link].name.as_str();
                w.create_element(role).with_attribute(("link", name)).write_empty()?;
            }
            let at = spaced(of.in_parent(joint).iter().copied());
            let attributes = [("xyz", at.as_str()), ("rpy", "0 0 0")];
            w.create_element("origin").with_attributes(attributes).write_empty()?;
            let axis = joint.axis.map(|x| x.to_string()).join(" ");
            w.create_element("axis").with_attribute(("xyz", axis.as_str())).write_empty()?;
            let [lower, upper] = joint.range.map(|q| q.to_string());
            w.create_element("limit")
                .with_attributes([("lower", lower.as_str()), ("upper", &upper)])
                .with_attributes([("effort", EFFORT), ("velocity", VELOCITY)])
                .write_empty()?;
            Ok(())
        })
        .map(drop)
}
