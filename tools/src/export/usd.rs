//! USD with its physics schema, as Isaac Sim and Omniverse read it, as text.
//!
//! The object is an articulation: rigid bodies beside each other, joints between them, and a fixed
//! joint between the base and the world. Angles of USD are degrees. USD's own physics has no friction of joints;
//! it is written under the names that Newton and MuJoCo read.

use super::cuboid::{Cuboid, Inertia};
use super::description::{Description, Link};
use super::joint::{Hinge, Motion};
use super::mesh::Mesh;
use super::names::{legal, usd as legal_name};
use nalgebra::{Matrix3, Point3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};

/// The description as USD.
///
/// # Errors
/// For screws, which it has not.
pub fn usd(of: &Description) -> anyhow::Result<String> {
    let of = &legal(of.without_screws("USD")?, legal_name, &["world_to_base"]);
    let bodies: String = of.links.iter().map(link).collect();
    let joints: String = of.joints.iter().map(|j| joint(of, j)).collect();
    let (remarks, name, base) = (of.remarks(), &of.name, &of.links[0].name);
    Ok(format!(
        r#"#usda 1.0
(
    doc = """{remarks}"""
    defaultPrim = "{name}"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def PhysicsScene "physics_scene"
{{
    vector3f physics:gravityDirection = (0, 0, -1)
    float physics:gravityMagnitude = 9.81
}}

def Xform "{name}" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
)
{{
{bodies}
    def PhysicsFixedJoint "world_to_base"
    {{
        rel physics:body1 = </{name}/{base}>
    }}
{joints}}}
"#
    ))
}

fn link(link: &Link) -> String {
    let Inertia { mass_kg, center, moments } = &link.inertia;
    let (principal, axes) = principal_moments(moments);
    let boxes = link.boxes.iter().enumerate();
    let boxes: String = boxes.map(|(i, b)| collision_box(i, b, link)).collect();
    let surface = link.mesh.as_ref().map_or(String::new(), surface);
    format!(
        r#"
    def Xform "{name}" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    )
    {{
        float physics:mass = {mass_kg}
        point3f physics:centerOfMass = {center}
        float3 physics:diagonalInertia = {principal}
        quatf physics:principalAxes = {axes}
        double3 xformOp:translate = {at}
        uniform token[] xformOpOrder = ["xformOp:translate"]
{boxes}{surface}    }}
"#,
        name = link.name,
        center = triple(center.coords),
        principal = triple(principal),
        axes = quaternion(&axes),
        at = triple(link.origin.coords),
    )
}

/// Moments about the principal axes, and these as a rotation.
fn principal_moments(moments: &Matrix3<f64>) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let SymmetricEigen { eigenvalues, mut eigenvectors } = moments.symmetric_eigen();
    if eigenvectors.determinant() < 0.0 {
        eigenvectors = -eigenvectors;
    }
    let rotation = Rotation3::from_matrix_unchecked(eigenvectors);
    (eigenvalues, UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Shown where no mesh is.
fn collision_box(number: usize, shape: &Cuboid, link: &Link) -> String {
    let purpose = if link.mesh.is_some() { "guide" } else { "default" };
    format!(
        r#"
        def Cube "box{number}" (
            prepend apiSchemas = ["PhysicsCollisionAPI"]
        )
        {{
            double size = 1
            float3[] extent = [(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)]
            color3f[] primvars:displayColor = [{colour}]
            uniform token purpose = "{purpose}"
            double3 xformOp:translate = {at}
            quatf xformOp:orient = {turned}
            float3 xformOp:scale = {size}
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]
        }}
"#,
        number = number + 1,
        colour = triple(link.colour.into()),
        at = triple(shape.center.coords),
        turned = quaternion(&shape.rotation),
        size = triple(shape.size),
    )
}

fn surface(mesh: &Mesh) -> String {
    let points = mesh.vertices.iter().map(|p| triple(p.coords));
    let colours = mesh.colours.iter().map(|c| triple((*c).into()));
    let counts = mesh.triangles.iter().map(|_| "3".to_owned());
    let corners = mesh.triangles.as_flattened().iter().map(u32::to_string);
    let extent = |pick: fn(&Vector3<f64>, &Vector3<f64>) -> Vector3<f64>| {
        let all = mesh.vertices.iter().map(|p: &Point3<f64>| p.coords);
        triple(all.reduce(|a, b| pick(&a, &b)).unwrap_or_default())
    };
    format!(
        r#"
        def Mesh "surface"
        {{
            uniform token subdivisionScheme = "none"
            float3[] extent = [{low}, {high}]
            int[] faceVertexCounts = [{counts}]
            int[] faceVertexIndices = [{corners}]
            point3f[] points = [{points}]
            color3f[] primvars:displayColor = [{colours}] (
                interpolation = "vertex"
            )
        }}
"#,
        low = extent(Vector3::inf),
        high = extent(Vector3::sup),
        counts = listed(counts),
        corners = listed(corners),
        points = listed(points),
        colours = listed(colours),
    )
}

fn joint(of: &Description, joint: &Hinge) -> String {
    let [parent, child] = [joint.parent, joint.child].map(|link| &of.links[link].name);
    let (kind, drive, unit) = match joint.motion {
        Motion::Slides => ("PhysicsPrismaticJoint", "linear", 1.0),
        _ => ("PhysicsRevoluteJoint", "angular", 180.0 / std::f64::consts::PI),
    };
    // The joint's x is its axis in both bodies.
    let x_to_axis = UnitQuaternion::rotation_between(&Vector3::x(), &joint.line.axis)
        .unwrap_or_else(|| {
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI)
        });
    let turned = quaternion(&x_to_axis);
    let [lower, upper] = joint.range.map(|q| number(q * unit));
    format!(
        r#"
    def {kind} "{name}" (
        prepend apiSchemas = ["PhysicsDriveAPI:{drive}"]
    )
    {{
        rel physics:body0 = </{object}/{parent}>
        rel physics:body1 = </{object}/{child}>
        uniform token physics:axis = "X"
        point3f physics:localPos0 = {at}
        quatf physics:localRot0 = {turned}
        point3f physics:localPos1 = (0, 0, 0)
        quatf physics:localRot1 = {turned}
        float physics:lowerLimit = {lower}
        float physics:upperLimit = {upper}
        float drive:{drive}:physics:stiffness = 0
        float drive:{drive}:physics:damping = {damping}
        float drive:{drive}:physics:maxForce = {effort}
        custom float newton:friction = {friction}
        custom float mjc:frictionloss = {friction}
    }}
"#,
        name = joint.name,
        object = of.name,
        at = triple(of.in_parent(joint)),
        damping = number(joint.damping / unit),
        effort = joint.effort,
        friction = joint.friction,
    )
}

/// A number in decimals.
fn number(x: f64) -> String {
    format!("{x:.9}")
}

fn triple(v: Vector3<f64>) -> String {
    let digits =
        |x: f64| if x != 0.0 && x.abs() < 1e-3 { format!("{x:e}") } else { format!("{x:.7}") };
    format!("({}, {}, {})", digits(v.x), digits(v.y), digits(v.z))
}

/// Real part first.
fn quaternion(q: &UnitQuaternion<f64>) -> String {
    format!("({:.9}, {:.9}, {:.9}, {:.9})", q.w, q.i, q.j, q.k)
}

fn listed(items: impl Iterator<Item = String>) -> String {
    items.collect::<Vec<_>>().join(", ")
}
