//! Surfaces from files: read in every format, refused with a sentence, looked at, touched, flown around.

use std::path::Path;
use vigil_sim::world::{Course, CourseError, Mesh, Outcome, Referee, VEHICLE, World};
use vigil_types::{Attitude, NedVector};

/// A field with what a mesh's entry says.
fn course(folder: &Path, entry: &str) -> Result<Course, CourseError> {
    let text = format!(
        "name = \"test\"\ngoal = {{ north_m = 20.0, east_m = 0.0 }}\n\
         bounds = {{ north_m = [-4.0, 26.0], east_m = [-10.0, 10.0], top_m = 6.0 }}\n[[mesh]]\n{entry}\n"
    );
    Course::from_toml_str(&text, &folder.join("test.toml").display().to_string())
}

/// Two triangles: a gate's post from the ground to 3 m, 1 m to 2 m east, 5 m north. Nothing thick, nothing closed.
const POST: [[f32; 3]; 4] = [[1.0, 5.0, 0.0], [2.0, 5.0, 0.0], [2.0, 5.0, 3.0], [1.0, 5.0, 3.0]];
const FACES: [[usize; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

fn obj(scale: f32) -> String {
    let corners = POST.map(|p| p.map(|x| format!("{}", x * scale)).join(" "));
    format!("v {}\nf 1 2 3 4\n", corners.join("\nv "))
}

/// A folder with the surface in metres and in millimetres.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, scale) in [("m.obj", 1.0), ("mm.obj", 1000.0)] {
        std::fs::write(folder.path().join(name), obj(scale)).expect("written");
    }
    folder
}

fn stl() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(2_u32.to_le_bytes());
    for face in FACES {
        bytes.extend([0; 12]);
        bytes.extend(face.iter().flat_map(|n| POST[*n]).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

#[test]
fn the_same_surface_stands_at_the_same_place_from_every_format() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| std::fs::write(folder.path().join(name), content).expect("written");
    write("m.stl", &stl());
    write("y.obj", b"v 1 0 -5\nv 2 0 -5\nv 2 3 -5\nv 1 3 -5\nf 1 2 3 4\n");
    for entry in [
        "file = \"m.obj\"",
        "file = \"mm.obj\"\nunit_m = 0.001",
        "file = \"m.stl\"",
        "file = \"y.obj\"\nup = \"y\"",
        // Turned to the right, what was 5 m north is 5 m east, and moved back.
        "file = \"m.obj\"\nyaw_deg = 90.0\nnorth_m = 6.5\neast_m = -3.5",
    ] {
        let course = course(folder.path(), entry).unwrap_or_else(|e| panic!("{entry}: {e}"));
        assert_eq!(course.meshes[0].triangles_and_open_edges(), Some((2, 4)), "{entry}");
        let world = World::new(&course);
        let clearance_m = world.clearance_m(NedVector::new(5.0, 0.0, -1.5));
        let expected_m = if entry.contains("yaw") {
            1.5_f32.hypot(0.5) - 0.08
        } else {
            1.0
        };
        assert!((clearance_m - expected_m).abs() < 0.01, "{entry}: {clearance_m}");
        let again = Course::from_toml_str(&course.to_toml_string().expect("writable"), "elsewhere/again.toml");
        assert_eq!(course, again.expect("read from where it was"));
    }
}

#[test]
fn what_cannot_be_used_is_refused_with_a_sentence() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| std::fs::write(folder.path().join(name), content).expect("written");
    write("points.obj", b"v 1 2 3\nv 2 3 4\n");
    write("nan.obj", obj(1.0).replace("v 2 5 3", "v 2 nan 3").as_bytes());
    write("prose.stl", b"this is not a mesh at all");
    write("cut.stl", &stl()[..120]);
    write("m.ply", b"ply");
    let mut many = b"v 1 5 0\nv 2 5 0\nv 2 5 3\n".to_vec();
    many.extend(b"f 1 2 3\n".repeat(1_000_001));
    write("many.obj", &many);
    // Ten million triangles.
    let large = std::fs::File::create(folder.path().join("large.stl")).expect("made");
    large.set_len(84 + 50 * 10_000_000).expect("as long");
    // The entry (a bar is a line's end) and what the sentence says.
    let cases = r#"
        file = "none.obj" => none.obj cannot be read
        file = "m.ply" => m.ply is no mesh by its name; one that is read ends in .obj or .stl
        file = "prose.stl" => prose.stl is not a mesh that can be read
        file = "cut.stl" => cut.stl is not a mesh that can be read
        file = "points.obj" => points.obj has no triangles; export its faces
        file = "m.obj"|height_m = -4.0 => m.obj has no triangles above the ground; raise it
        file = "nan.obj" => nan.obj has a corner that is not a number, of triangle 1;
        file = "many.obj" => many.obj has 1000001 triangles, at most 1000000 can be cast; simplify it
        file = "large.stl" => large.stl holds 476 MB, at most 256 MB are read; simplify it to at most 1000000 triangles
        file = "mm.obj" => mm.obj is 3000 m wide: is it in millimetres? Then unit_m = 0.001
        file = "m.obj"|unit_m = 0.0 => unit_m`: is 0, must be the metres of the file's unit
        file = "m.obj"|east_m = 40.0 => mesh[0]`: lies wholly outside of `bounds`
        file = "m.obj"|north_m = -5.2|east_m = -1.2 => is nearer to the start at [0, 0] than the vehicle's radius
        file = "m.obj"|north_m = 15.0|east_m = -1.5 => is nearer to the goal at [20, 0]
        file = "m.obj"|up = "north" => mesh[0].up
    "#;
    let cases: Vec<_> = cases
        .lines()
        .filter_map(|case| case.trim().split_once(" => "))
        .collect();
    assert_eq!(cases.len(), 15);
    for (entry, expected) in cases {
        let error = course(folder.path(), &entry.replace('|', "\n"))
            .expect_err(entry)
            .to_string();
        assert!(
            error.contains("test.toml:") && error.contains(expected),
            "{entry}: {error}"
        );
    }
}

/// How a flight along points ends.
fn flown(course: &Course, way: &[[f32; 2]]) -> Outcome {
    let (world, mut referee) = (World::new(course), Referee::new(course));
    let mut at_ns = 0;
    for ends in way.windows(2) {
        for step in 0..=100_u8 {
            let [north_m, east_m] = [0, 1].map(|k| ends[0][k] + f32::from(step) / 100.0 * (ends[1][k] - ends[0][k]));
            let place = NedVector::new(north_m, east_m, -course.flight_height_m);
            at_ns += 10_000_000;
            if let Some(outcome) = referee.observe(&world, at_ns, place, Attitude::LEVEL_NORTH, NedVector::ZERO) {
                return outcome;
            }
        }
    }
    panic!("not ended")
}

#[test]
fn in_the_vaulted_hall_the_way_leads_through_the_door_and_the_wall_is_hit() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("courses/nave.toml");
    let course = Course::load(&file).expect("valid");
    let way = course.corridor().expect("through the door");
    assert_eq!(flown(&course, &way), Outcome::Success);
    assert!(course.straight_line_is_blocked());
    assert_eq!(flown(&course, &[[0.0, 0.0], [19.0, -2.0]]), Outcome::Collision);
    // Without the wall across there is nothing in the way: whoever is inside of a closed mesh is in a hall.
    assert!(World::new(&course).clearance_m(NedVector::new(5.0, 0.0, -1.2)) > 2.5);
}

/// A surface's distances and touches are those of parry's own mesh.
#[test]
fn the_vehicle_touches_a_surface_where_parry_says() {
    use parry3d::math::{Pose3, Vec3};
    use parry3d::query::PointQuery;
    let at =
        |f: f32, reach: f32| NedVector::new(reach * f.sin(), reach * (1.7 * f).cos(), -3.0 + 2.5 * (2.3 * f).sin());
    let triangles: Vec<[NedVector; 3]> = (0..600_u16)
        .map(|n| [0.0, 0.31, 0.62].map(|k| at(f32::from(n) + 0.2 * k, 6.0)))
        .collect();
    let mut course = vigil_sim::world::generate(vigil_sim::world::Family::Training, 1);
    course.clear_obstacles();
    course.ceiling_height_m = None;
    course.meshes.push(Mesh::of_triangles(&triangles).expect("a mesh"));
    let world = World::new(&course);
    let points = triangles.iter().flatten().map(|p| Vec3::from(p.to_array())).collect();
    let numbers = (0..triangles.len() as u32)
        .map(|n| [3 * n, 3 * n + 1, 3 * n + 2])
        .collect();
    let theirs = parry3d::shape::TriMesh::new(points, numbers).expect("a mesh");
    let body = parry3d::shape::Cylinder::new(0.5 * VEHICLE.height_m, VEHICLE.radius_m);
    let upright = glamx::Quat::from_xyzw(0.5_f32.sqrt(), 0.0, 0.0, 0.5_f32.sqrt());
    let mut touched = 0;
    for n in 0..1500_u16 {
        let place = at(0.37 * f32::from(n), 7.0);
        let p = Vec3::from(place.to_array());
        let distance_m = theirs.distance_to_local_point(p, false);
        assert!((world.clearance_m(place) - distance_m).abs() < 1e-4, "{place:?}");
        let pose = Pose3::from_parts(p, upright);
        let expected = parry3d::query::intersection_test(&pose, &body, &Pose3::IDENTITY, &theirs).expect("supported");
        let ours = world.collides_at(0, &VEHICLE, place, Attitude::LEVEL_NORTH);
        assert_eq!(ours, expected.intersecting, "{place:?} {distance_m}");
        touched += u32::from(ours);
    }
    assert!((100..1400).contains(&touched), "{touched}");
}
