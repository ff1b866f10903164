//! Exports in the simulators that read them: each loads without a warning, its parts keep apart, it
//! rests where it is put, and it falls only as its joints allow.
//!
//! The simulators are Python packages, which tools/setup installs. Drake reads SDF by Gazebo's own library,
//! and strictly; Newton simulates USD on the processor.

use linkage_tests::{failure, learned, linkage, python_with, shared_data, simulated};
use nalgebra::{
    Isometry3, Matrix3, Point3, Quaternion, SymmetricEigen, Translation3, UnitQuaternion, Vector2,
    Vector3,
};
use serde_json::Value;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Deepest overlap of two parts, millimetres.
const OVERLAP_MM: f64 = 5.0;
/// Movement of a joint at rest, radians or metres.
const REST: f64 = 1e-4;
/// How far a joint that falls may press into its limit: simulators' limits are soft. Radians or metres.
const SOFT_LIMIT: f64 = 0.06;

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// A store in a folder that knows a drawer.
fn drawer(dir: &Path) -> PathBuf {
    learned("drawer", dir)
}

/// Exports an object; with meshes where they are wanted.
fn exported(store: &Path, object: &str, format: &str, has_meshes: bool) -> PathBuf {
    let ending = if format == "usd" { "usda" } else { format };
    let out = store.with_file_name(format!("{object}.{ending}"));
    let (at, file) = (text(store), text(&out));
    let mut arguments = vec!["export", object, "--store", &at, "--format", format, "--out", &file];
    if has_meshes {
        arguments.push("--mesh");
    }
    let output = linkage(&arguments);
    assert!(output.status.success(), "{}", failure(&output).1);
    out
}

/// What a simulator says of a file.
fn checked(python: &Path, simulator: &str, file: &Path) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/check_export.py");
    let output = Command::new(python)
        .args([&script, Path::new(simulator), file])
        .output()
        .expect("the Python of the tests starts");
    assert!(output.status.success(), "{simulator}, {}: {}", file.display(), failure(&output).1);
    let said = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(said.lines().last().unwrap_or_default()).expect("it prints JSON")
}

/// Loads all formats of an object in a simulator; tells how far joints fell in all. `learn` makes the
/// store that knows it in a folder.
fn accepts(
    simulator: &str,
    package: &str,
    formats: &[&str],
    object: &str,
    learn: impl FnOnce(&Path) -> PathBuf,
) -> f64 {
    let Some(python) = python_with(&[package]) else { return f64::INFINITY };
    let dir = tempfile::tempdir().unwrap();
    let store = learn(dir.path());
    let mut fallen = 0.0;
    for format in formats {
        for has_meshes in [false, true] {
            let said = checked(&python, simulator, &exported(&store, object, format, has_meshes));
            let number = |key: &str| said[key].as_f64().expect("a number");
            let of = format!("{object}.{format} in {simulator}: {said}");
            assert!(said["warnings"].as_array().expect("a list").is_empty(), "{of}");
            assert!(said["joints"].as_u64().expect("a number") >= 1, "{of}");
            assert!(number("overlap_mm") < OVERLAP_MM, "{of}");
            assert!(number("moved") < REST, "{of}");
            assert!(number("off_joint") < SOFT_LIMIT, "{of}");
            let fell = said["fell"].as_array().into_iter().flatten();
            fallen += fell.filter_map(Value::as_f64).sum::<f64>();
        }
    }
    fallen
}

#[test]
fn a_drawer_rests_and_falls_in_mujoco() {
    let fallen = accepts("mujoco", "mujoco", &["mjcf", "urdf"], "drawer", drawer);
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_drawer_is_sound_usd() {
    accepts("usd", "pxr", &["usd"], "drawer", drawer);
}

#[test]
fn a_drawer_in_usd_rests_and_falls_in_newton() {
    let fallen = accepts("newton", "newton", &["usd"], "drawer", drawer);
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_drawer_rests_and_falls_in_pybullet() {
    let fallen = accepts("pybullet", "pybullet", &["urdf"], "drawer", drawer);
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_drawer_rests_and_falls_in_drake() {
    let package = "pydrake.multibody.plant";
    let fallen = accepts("drake", package, &["urdf", "sdf"], "drawer", drawer);
    assert!(fallen > 0.1, "the drawer is stuck");
}

#[test]
fn a_cabinet_of_which_one_door_was_hardly_seen_rests_and_falls_in_mujoco() {
    let Some(recording) = shared_data("demos/hingecab_demo1") else { return };
    let learn = |dir: &Path| {
        let (recording, store) = (text(&recording), dir.join("objects.linkage"));
        let arguments = ["learn", &recording, "--object", "cabinet", "--quiet", "--store"];
        let output = linkage(&[&arguments[..], &[&text(&store)]].concat());
        assert!(output.status.success(), "{}", failure(&output).1);
        store
    };
    let fallen = accepts("mujoco", "mujoco", &["mjcf", "urdf"], "cabinet", learn);
    assert!(fallen > 0.1, "the doors are stuck");
}

/// Median distance of a mesh from the true surface, millimetres.
const OFF_SURFACE_MM: f64 = 5.0;
/// Side of a pixel of the picture that holes are sought in, metres.
const PIXEL_M: f64 = 0.003;

#[test]
fn meshes_are_watertight_and_lie_on_the_true_surface() {
    // A place of the laptop's lid, 5 cm wide, was not seen. The fridge's holes are 1.7 or 2.3 % with hinges that are
    // 0.1 mm apart.
    for (thing, most_holes) in [("drawer", 0.01), ("fridge", 0.03), ("laptop", 0.05)] {
        let dir = tempfile::tempdir().unwrap();
        let recording = simulated(thing, false, 1);
        let store = learned(thing, dir.path());
        let description = exported(&store, thing, "urdf", true);
        let model = exported(&store, thing, "json", false);
        let truth = TrueSurface::read(&recording.join("truth.json"));
        for (part, origin) in origins(&model).into_iter().enumerate() {
            let file = dir.path().join(format!("{thing}_meshes/part{part}.obj"));
            let mesh = Mesh::read(&file, &description, &origin);
            let off_mm = 1e3 * truth.median_distance_m(&mesh);
            let holes = mesh.share_of_holes();
            let (triangles, kib) = (mesh.triangles.len(), file.metadata().unwrap().len() / 1024);
            println!(
                "{thing}, part {part}: {off_mm:.2} mm off the surface, {holes:.4} holes, \
                 {triangles} triangles, {kib} KiB"
            );
            let faulty = mesh.edges_not_in_two_triangles();
            assert_eq!(faulty, 0, "{thing}, part {part}: it is not watertight");
            assert!(off_mm < OFF_SURFACE_MM, "{thing}, part {part}: {off_mm} mm");
            assert!(holes < most_holes, "{thing}, part {part}: {holes} of it are holes");
        }
    }
}

/// Origin of each part's link, in the object frame: on the joint that moves it.
fn origins(model: &Path) -> Vec<Point3<f64>> {
    let model: Value = serde_json::from_slice(&std::fs::read(model).unwrap()).unwrap();
    let joints = model["joints"].as_array().unwrap();
    let parts = model["parts"].as_array().unwrap().len();
    let moved_by = |part: usize| joints.iter().find(|j| j["child"] == part);
    let origin = |part: usize| moved_by(part).map_or(Point3::origin(), |j| point(&j["origin"]));
    (0..parts).map(origin).collect()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn point(value: &Value) -> Point3<f64> {
    Point3::from_slice(&numbers(value))
}

/// `[x, y, z, qx, qy, qz, qw]` as a pose.
fn pose(value: &Value) -> Isometry3<f64> {
    let n = numbers(value);
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(n[6], n[3], n[4], n[5]));
    Isometry3::from_parts(Translation3::new(n[0], n[1], n[2]), turn)
}

/// A mesh in the object frame, which is the camera's of the first frame.
struct Mesh {
    places: Vec<Point3<f64>>,
    triangles: Vec<[usize; 3]>,
}

impl Mesh {
    /// Edges that are not in two triangles that go along them in opposite directions.
    fn edges_not_in_two_triangles(&self) -> usize {
        let mut gone_along: HashMap<[usize; 2], [usize; 2]> = HashMap::new();
        for [a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let edge = [*from.min(to), *from.max(to)];
                gone_along.entry(edge).or_default()[usize::from(from < to)] += 1;
            }
        }
        gone_along.values().filter(|ways| **ways != [1, 1]).count()
    }

    /// Reads an OBJ file that a description names, of a link whose origin is known.
    fn read(file: &Path, description: &Path, origin: &Point3<f64>) -> Self {
        let text = std::fs::read_to_string(file).unwrap();
        // The head of the description tells the rotation from the object frame.
        let head = std::fs::read_to_string(description).unwrap();
        let told = head.split_once("qx qy qz qw: ").expect("a rotation").1;
        let q: Vec<f64> = told
            .split_whitespace()
            .take(4)
            .map(|x| x.trim_end_matches('.').parse().unwrap())
            .collect();
        let from_object = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
        let rows = |kind: &'static str| {
            text.lines().filter_map(move |l| l.strip_prefix(kind)).map(str::split_whitespace)
        };
        let places = rows("v ").map(|row| {
            let at: Vec<f64> = row.take(3).map(|x| x.parse().unwrap()).collect();
            origin + from_object.inverse() * Vector3::from_row_slice(&at)
        });
        let triangles = rows("f ").map(|row| {
            let corner = |c: &str| c.split('/').next().unwrap().parse::<usize>().unwrap() - 1;
            let corners: Vec<usize> = row.map(corner).collect();
            [corners[0], corners[1], corners[2]]
        });
        Self { places: places.collect(), triangles: triangles.collect() }
    }

    /// Corners on the outer side: what is behind them is within the body, a thickness away.
    fn outer_side(&self, truth: &TrueSurface) -> Vec<Point3<f64>> {
        let mut normals = vec![Vector3::zeros(); self.places.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|i| self.places[i]);
            triangle.iter().for_each(|&i| normals[i] += (b - a).cross(&(c - a)));
        }
        let is_outer = |(at, normal): (&Point3<f64>, &Vector3<f64>)| {
            let step = normal.try_normalize(1e-15)? * 0.004;
            (truth.depth_m(&(at - step)) > truth.depth_m(&(at + step))).then_some(*at)
        };
        self.places.iter().zip(&normals).filter_map(is_outer).collect()
    }

    /// The share of what it covers, seen along its main direction, that is holes in it: places that
    /// it does not cover and from which no way leads outside.
    fn share_of_holes(&self) -> f64 {
        let (flat, width, height) = self.seen_flat();
        let mut covered = vec![false; width * height];
        for triangle in &self.triangles {
            let corners = triangle.map(|i| flat[i]);
            let low = corners.iter().fold(corners[0], |a, b| a.inf(b)).map(f64::floor);
            let high = corners.iter().fold(corners[0], |a, b| a.sup(b)).map(f64::ceil);
            for y in low.y as usize..=high.y as usize {
                for x in low.x as usize..=high.x as usize {
                    let at = Vector2::new(x as f64, y as f64);
                    covered[y * width + x] |= is_within(&at, &corners);
                }
            }
        }
        // The border of the picture is outside.
        let (mut outside, mut front) = (vec![false; width * height], vec![0]);
        while let Some(i) = front.pop() {
            if covered[i] || std::mem::replace(&mut outside[i], true) {
                continue;
            }
            let (x, y) = (i % width, i / width);
            front.extend([(x > 0).then(|| i - 1), (x + 1 < width).then(|| i + 1)].iter().flatten());
            front.extend(
                [(y > 0).then(|| i - width), (y + 1 < height).then(|| i + width)].iter().flatten(),
            );
        }
        let count =
            |of: &dyn Fn(usize) -> bool| (0..width * height).filter(|i| of(*i)).count() as f64;
        count(&|i| !covered[i] && !outside[i]) / count(&|i| covered[i])
    }

    /// Its corners in a picture along its main direction, with the picture's columns and rows.
    fn seen_flat(&self) -> (Vec<Vector2<f64>>, usize, usize) {
        let mut spread = Matrix3::zeros();
        for [a, b, c] in self.triangles.iter().map(|t| t.map(|i| self.places[i])) {
            let normal = (b - a).cross(&(c - a));
            spread += normal * normal.transpose() / normal.norm().max(1e-12);
        }
        let eigen = SymmetricEigen::new(spread);
        let main = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let right = main.cross(&Vector3::ith(main.iamin(), 1.0)).normalize();
        let down = main.cross(&right);
        let flat =
            |p: &Point3<f64>| Vector2::new(p.coords.dot(&right), p.coords.dot(&down)) / PIXEL_M;
        let flat: Vec<Vector2<f64>> = self.places.iter().map(flat).collect();
        let low = flat.iter().fold(flat[0], |a, b| a.inf(b)) - Vector2::repeat(2.0);
        let high = flat.iter().fold(flat[0], |a, b| a.sup(b)) - low + Vector2::repeat(3.0);
        let (width, height) = (high.x.ceil() as usize, high.y.ceil() as usize);
        (flat.into_iter().map(|p| p - low).collect(), width, height)
    }
}

/// True where a place lies in a triangle, whichever way that turns.
fn is_within(at: &Vector2<f64>, [a, b, c]: &[Vector2<f64>; 3]) -> bool {
    let side = |a: &Vector2<f64>, b: &Vector2<f64>| (b - a).perp(&(at - a));
    let sides = [side(a, b), side(b, c), side(c, a)];
    sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)
}

/// The solids that were rendered, in the first frame's camera.
struct TrueSurface {
    solids: Vec<(String, Vector3<f64>, Isometry3<f64>)>,
}

impl TrueSurface {
    fn read(truth: &Path) -> Self {
        let truth: Value = serde_json::from_slice(&std::fs::read(truth).unwrap()).unwrap();
        let solids = truth["solids"].as_array().unwrap().iter().map(|solid| {
            let form = solid["form"].as_str().unwrap().to_owned();
            let half = Vector3::from_vec(numbers(&solid["half_m"]));
            (form, half, pose(&solid["camera_from_solid"]))
        });
        Self { solids: solids.collect() }
    }

    /// How deep a place lies within the nearest solid, metres; below 0 outside.
    fn depth_m(&self, at: &Point3<f64>) -> f64 {
        let outside = |(form, half, pose): &(String, Vector3<f64>, Isometry3<f64>)| {
            let p = pose.inverse_transform_point(at).coords;
            let beyond = match form.as_str() {
                "box" => p.abs() - half,
                "drum" => Vector3::new(p.x.hypot(p.z) - half.x, p.y.abs() - half.y, -1e9),
                _ => {
                    let on_axis = Vector3::new(0.0, p.y.clamp(-half.y, half.y), 0.0);
                    Vector3::new((p - on_axis).norm() - half.x, -1e9, -1e9)
                }
            };
            beyond.map(|x| x.max(0.0)).norm() + beyond.max().min(0.0)
        };
        -self.solids.iter().map(outside).fold(f64::INFINITY, f64::min)
    }

    /// Median distance of the outer side of a mesh.
    fn median_distance_m(&self, mesh: &Mesh) -> f64 {
        let outer = mesh.outer_side(self);
        assert!(outer.len() > 100, "{} corners", outer.len());
        let mut off: Vec<f64> = outer.iter().map(|p| self.depth_m(p).abs()).collect();
        off.sort_by(f64::total_cmp);
        off[off.len() / 2]
    }
}

#[test]
fn meshes_need_a_file_and_lie_beside_it() {
    let dir = tempfile::tempdir().unwrap();
    let store = drawer(dir.path());
    let output =
        linkage(&["export", "drawer", "--store", &text(&store), "--format", "urdf", "--mesh"]);
    assert_eq!(failure(&output).0, 2, "{}", failure(&output).1);
    let urdf = std::fs::read_to_string(exported(&store, "drawer", "urdf", true)).unwrap();
    assert!(urdf.contains("<mesh filename=\"drawer_meshes/part1.obj\"/>"), "{urdf}");
    let front = std::fs::read_to_string(dir.path().join("drawer_meshes/part1.obj")).unwrap();
    let coloured = front.lines().filter(|l| l.starts_with("v ") && l.split(' ').count() == 7);
    assert!(coloured.count() > 20);
    let faces = front.lines().filter(|l| l.starts_with("f ")).count();
    assert!((20..=4400).contains(&faces), "{faces} faces");
}
