//! Surfaces from files: read in every format, refused with a sentence, looked at, touched, flown around.

#[path = "common/flown.rs"]
mod flown;

use base64::Engine;
use flown::fly;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use vigil_sim::world::{Course, CourseError, Mesh, Outcome, VEHICLE, World};
use vigil_types::{Attitude, NedVector};

/// A field with what a mesh's entry says.
fn course(folder: &Path, entry: &str) -> Result<Course, CourseError> {
    let text = format!(
        "name = \"test\"\ngoal = {{ north_m = 20.0, east_m = 0.0 }}\n\
         bounds = {{ north_m = [-4.0, 26.0], east_m = [-10.0, 10.0], top_m = 6.0 }}\n[[mesh]]\n{entry}\n"
    );
    std::fs::write(folder.join("test.toml"), text).expect("written");
    Course::load(&folder.join("test.toml"))
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

/// With y up and z south, half of the height by the node's scale: text, and what its buffer holds. Corners are 16 bytes apart; indices are those
/// of triangles, of a strip, and of a fan.
fn gltf() -> (String, Vec<u8>) {
    let corners = POST.iter().flat_map(|[x, y, z]| [*x, 0.5 * z, -y, f32::NAN]);
    let mut bytes: Vec<u8> = corners.flat_map(f32::to_le_bytes).collect();
    bytes.extend(FACES.iter().flatten().flat_map(|n| (*n as u16).to_le_bytes()));
    bytes.extend([0, 1, 3, 2]);
    bytes.extend([1_u32, 2, 3, 0].iter().flat_map(|n| n.to_le_bytes()));
    let text = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"extensionsRequired":["KHR_materials_unlit"],
"nodes":[{"children":[1]},{"mesh":0,"scale":[1,2,1]}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1},{"attributes":{},"mode":1}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},
{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"},
{"bufferView":1,"byteOffset":12,"componentType":5121,"count":4,"type":"SCALAR"},
{"bufferView":1,"byteOffset":16,"componentType":5125,"count":4,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteLength":64,"byteStride":16},{"buffer":0,"byteOffset":64,"byteLength":32}],
"buffers":[{"byteLength":96}]}"#;
    (text.to_owned(), bytes)
}

/// The same surface in other ways: what is replaced by what.
const OTHER_WAYS: [[&str; 2]; 5] = [
    [r#""scale":[1,2,1]"#, r#""matrix":[1,0,0,0, 0,2,0,0, 0,0,1,0, 0,0,0,1]"#],
    ["[1]}", r#"[1],"rotation":[0,2,0,0],"translation":[3,0,-10]}"#],
    [r#""indices":1"#, r#""mode":6"#],
    [r#""indices":1"#, r#""indices":2,"mode":5"#],
    [r#""indices":1"#, r#""indices":3,"mode":6"#],
];

/// The same with the buffer at an address.
fn gltf_at(uri: &str) -> String {
    gltf().0.replace("96}]", &format!(r#"96,"uri":"{uri}"}}]"#))
}

/// A GLB of a text and a buffer.
fn glb(text: &str, buffer: &[u8]) -> Vec<u8> {
    let part = |kind: &[u8], content: &[u8]| [&(content.len() as u32).to_le_bytes(), kind, content].concat();
    let parts = [part(b"JSON", text.as_bytes()), part(b"BIN\0", buffer)].concat();
    [&b"glTF\x02\0\0\0"[..], &(12 + parts.len() as u32).to_le_bytes(), &parts].concat()
}

#[test]
fn the_same_surface_stands_at_the_same_place_from_every_format() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| std::fs::write(folder.path().join(name), content).expect("written");
    write("m.stl", &stl());
    // No UTF-8, a material without a name, a face on two lines, comments behind, and a line of several points, which is no face.
    let remarked = obj(1.0).replace("2 3 4", "2 \\\n 3 4 # x").replace("5 3", "5 3 # c\\") + "l 1 2 3\n";
    let latin = [&b"# caf\xe9\no Geb\xe4ude\\\nusemtl\n"[..], remarked.as_bytes()].concat();
    write("latin.obj", &latin);
    // Textures and normals that nobody uses.
    let textured = obj(1.0).replace("1 2 3 4", "1/7 2/1/9 3//2 -1/");
    write(
        "textured.obj",
        format!("vt 0.5\nvt -1.#IND 0\nvn 0 1\n{textured}").as_bytes(),
    );
    write("y.obj", b"v 1 0 -5\nv 2 0 -5\nv 2 3 -5\nv 1 3 -5\nf 1 2 3 4\n");
    let (text, buffer) = gltf();
    let data = base64::engine::general_purpose::STANDARD.encode(&buffer);
    write(
        "m.gltf",
        gltf_at(&format!("data:application/octet-stream;base64,{data}")).as_bytes(),
    );
    write("beside.gltf", gltf_at("its%20d%C3%a4ta%.bin").as_bytes());
    write("its däta%.bin", &buffer);
    write("m.GLB", &glb(&text, &buffer));
    for name in ["m.gltf", "m.obj"] {
        let content = std::fs::read(folder.path().join(name)).expect("readable");
        write(&format!("marked {name}"), &[b"\xef\xbb\xbf", &content[..]].concat());
    }
    for (n, [from, to]) in OTHER_WAYS.iter().enumerate() {
        write(&format!("{n}.glb"), &glb(&text.replace(from, to), &buffer));
    }
    let others = (0..OTHER_WAYS.len()).map(|n| format!("file = \"{n}.glb\""));
    let entries = [
        "file = \"m.gltf\"",
        "file = \"beside.gltf\"\nup = \"y\"",
        "file = \"m.GLB\"",
        "file = \"marked m.gltf\"",
        "file = \"marked m.obj\"",
        "file = \"m.obj\"",
        "file = \"mm.obj\"\nunit_m = 0.001",
        "file = \"latin.obj\"",
        "file = \"textured.obj\"",
        "file = \"m.stl\"",
        "file = \"y.obj\"\nup = \"y\"",
        // Turned to the right, what was 5 m north is 5 m east, and moved back.
        "file = \"m.obj\"\nyaw_deg = 90.0\nnorth_m = 6.5\neast_m = -3.5",
    ];
    for entry in entries.map(String::from).into_iter().chain(others) {
        let course = course(folder.path(), &entry).unwrap_or_else(|e| panic!("{entry}: {e}"));
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
    // A folder's name need not be Unicode.
    let named = folder.path().join(OsStr::from_bytes(b"caf\xe9"));
    std::fs::create_dir(&named).expect("made");
    std::fs::write(named.join("m.obj"), obj(1.0)).expect("written");
    let unwritable = course(&named, "file = \"m.obj\"").expect("a course").to_toml_string();
    let error = unwritable.expect_err("no text").to_string();
    assert!(
        error.ends_with("in a folder whose name is not Unicode: move it"),
        "{error}"
    );
}

#[test]
fn a_text_stl_is_read_whole_however_many_solids_it_has_and_however_they_are_spelt() {
    let folder = folder();
    let [a, b] = FACES.map(|face| {
        let corners = face.map(|n| format!("vertex {}\n", POST[n].map(|x| x.to_string()).join(" ")));
        let corners = corners.concat();
        format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
    });
    for text in [
        format!("solid a\n{a}endsolid a\nsolid b\n{b}endsolid b\n"),
        format!("solid b\n{b}endsolid b\n\nsolid a\n{a}endsolid a"),
        format!("  solid\n{a}{b}endsolid\n"),
        format!("solid a\n{a}{b}endsolid a\n").to_uppercase(),
        format!("\u{feff}solid a\n{a}{b}endsolid a\n"),
        format!("solid a\n{a}{b}endsolid a\n").replace("normal 0 0 0", "normal -1.#IND nan 0"),
    ] {
        std::fs::write(folder.path().join("text.stl"), &text).expect("written");
        let course = course(folder.path(), "file = \"text.stl\"").unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(course.meshes[0].triangles_and_open_edges(), Some((2, 4)), "{text}");
    }
}

#[test]
fn a_triangle_that_is_a_line_neither_opens_nor_closes_an_edge() {
    let [a, b, c] = [[1.0, -1.0], [2.0, -1.0], [1.0, -2.0]].map(|[east_m, z]| NedVector::new(5.0, east_m, z));
    let mesh = Mesh::of_triangles(&[[a, b, c], [a, b, b]]).expect("a mesh");
    assert_eq!(mesh.triangles_and_open_edges(), Some((1, 3)));
}

#[test]
fn what_cannot_be_used_is_refused_with_a_sentence() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| std::fs::write(folder.path().join(name), content).expect("written");
    write("points.obj", b"v 1 2 3\nv 2 3 4\n");
    write("nan.obj", obj(1.0).replace("v 2 5 3", "v 2 nan 3").as_bytes());
    let (text, buffer) = gltf();
    let nan = [&f32::NAN.to_le_bytes(), &buffer[4..]].concat();
    write("nan.glb", &glb(&text, &nan));
    write("prose.stl", b"this is not a mesh at all");
    write("cut.stl", &stl()[..120]);
    write("open.stl", b"solid a\nfacet normal 0 0 1\n");
    write("m.ply", b"ply");
    write("far.obj", obj(1.0).replace("v ", "v 50000").as_bytes());
    // A ramp that the start is on, 2 cm high there.
    write("ramp.obj", b"v -1 -1 0.01\nv 1 -1 0.01\nv 0 15 0.1\nf 1 2 3\n");
    // A wall with a door, as one face.
    let door = "v 1 5 0\nv 2 5 0\nv 2 5 2\nv 3 5 2\nv 3 5 0\nv 4 5 0\nv 4 5 3\nv 1 5 3\nf 1 2 3 4 5 6 7 8\n";
    write("door.obj", door.as_bytes());
    let mut many = b"v 1 5 0\nv 2 5 0\nv 2 5 3\n".to_vec();
    many.extend(b"f 1 2 3\n".repeat(1_000_001));
    write("many.obj", &many);
    // Ten million triangles.
    let large = std::fs::File::create(folder.path().join("large.stl")).expect("made");
    large.set_len(84 + 50 * 10_000_000).expect("as long");
    // The entry (a bar is a line's end) and what the sentence says.
    let cases = r#"
        file = "none.obj" => none.obj cannot be read
        file = "m.ply" => m.ply is no mesh by its name; one that is read ends in .obj, .stl, .gltf or .glb
        file = "prose.stl" => prose.stl is not a mesh that can be read
        file = "cut.stl" => cut.stl is not a mesh that can be read
        file = "open.stl" => open.stl is not a mesh that can be read (it is cut off); export it again
        file = "door.obj" => (it has a face of 8 corners that is not convex: triangulate its faces)
        file = "far.obj" => far.obj lies 500002 m from its file's origin; export it about its own middle
        file = "ramp.obj" => is nearer to the start at [0, 0] than the vehicle's radius
        file = "points.obj" => points.obj has no triangles; export its faces
        file = "m.obj"|height_m = -4.0 => m.obj has no triangles above the ground; raise it
        file = "nan.obj" => nan.obj has a corner that is not a number, of triangle 1;
        file = "nan.glb" => nan.glb has a corner that is not a number, of triangle 1;
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
    assert_eq!(cases.len(), 20);
    for (entry, expected) in cases {
        let error = course(folder.path(), &entry.replace('|', "\n"))
            .expect_err(entry)
            .to_string();
        assert!(error.contains("test.toml:"), "{entry}: {error}");
        assert!(error.contains(expected), "{entry}: {error}");
    }
}

/// What of a glTF is replaced by what, and what the sentence says.
const REFUSED_GLTF: &str = r#"
        KHR_materials_unlit => KHR_draco_mesh_compression => it requires KHR_draco_mesh_compression: export it without, uncompressed
        KHR_materials_unlit => EXT_meshopt_compression => it requires EXT_meshopt_compression: export it without
        "2.0" => "1.0" => it is of glTF 1.0: export it as 2.0
        "scenes":[{"nodes":[0]}], =>  => scene 0 is not in the file
        "children":[1] => "children":[1,2] => node 2 is not in the file
        "mesh":0 => "mesh":0,"children":[0] => node 0 is its own descendant, or has two parents
        "mesh":0 => "mesh":1 => mesh 1 is not in the file
        "mesh":0 => "mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{}} => node 1 is instanced by EXT_mesh_gpu_instancing: export it
        "POSITION":0 => "NORMAL":0 => a mesh has no positions
        "indices":1 => "indices":7 => accessor 7 is not in the file
        "indices":1 => "indices":0 => accessor 0 has VEC3 of type 5126, which is not read there
        "POSITION":0 => "POSITION":1 => accessor 1 has SCALAR of type 5123, which is not read there
        "type":"VEC3" => "type":"VEC3","sparse":{"count":1} => accessor 0 has sparse VEC3 of type 5126, which is not read there
        {"bufferView":0, => { => the data of accessor 0 are missing
        "bufferView":0 => "bufferView":4 => the data of accessor 0 are missing
        "count":4 => "count":5 => accessor 0 reaches beyond its data
        "count":4 => "count":0 => accessor 0 reaches beyond its data
        "count":4 => "count":18446744073709551615 => accessor 0 reaches beyond its data
        "count":4 => "count":3 => a face has a corner that accessor 0 does not have
        "byteStride":16 => "byteStride":8 => accessor 0 reaches beyond its data
        "byteLength":32 => "byteLength":33 => accessor 1 reaches beyond its data
        {"buffer":0,"byteLength":64 => {"buffer":1,"byteLength":64 => accessor 0 reaches beyond its data
        "byteLength":96 => "byteLength":97 => buffer 0 has 96 of 97 bytes
        96}] => 96},{"byteLength":1}] => the data of buffer 1 are missing
        [1,2,1] => [1,1e999,1] => number out of range
        "nodes":[{ => "nodes":[3,{ => invalid type
    "#;

#[test]
fn a_gltf_that_cannot_be_used_is_refused_with_a_sentence() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| std::fs::write(folder.path().join(name), content).expect("written");
    let refused = |name: &str, expected: &str| {
        let error = course(folder.path(), &format!("file = {name:?}")).expect_err(expected);
        let error = error.to_string();
        let sentence = format!("{name} is not a mesh that can be read ({expected}");
        assert!(error.contains(&sentence), "{expected}: {error}");
    };
    let (text, buffer) = gltf();
    let cases: Vec<Vec<&str>> = REFUSED_GLTF
        .lines()
        .map(|case| case.trim().split(" => ").collect())
        .collect();
    let mut count = 0;
    for case in cases.iter().filter(|case| case.len() == 3) {
        let wrong = text.replacen(case[0], case[1].trim(), 1);
        assert_ne!(wrong, text, "{case:?}");
        write("wrong.glb", &glb(&wrong, &buffer));
        refused("wrong.glb", case[2]);
        count += 1;
    }
    assert_eq!(count, 26);
    let whole = glb(&text, &buffer);
    for (content, expected) in [
        (&whole[..11], "it is no GLB of version 2"),
        (&[b"glTF\x01", &whole[5..]].concat()[..], "it is no GLB of version 2"),
        (&whole[..18], "its JSON part is missing"),
        (&whole[..whole.len() - 1], "it is cut short"),
        (text.as_bytes(), "the data of buffer 0 are missing"),
        (
            gltf_at("none.bin").as_bytes(),
            "its none.bin beside it cannot be read: ",
        ),
        (gltf_at("data:;base64,?").as_bytes(), "its data within are not base64"),
    ] {
        write("wrong.gltf", content);
        refused("wrong.gltf", expected);
    }
    // A million triangles by instances of one that has two.
    let nodes: Vec<String> = (1..=500_001).map(|n| n.to_string()).collect();
    let instances = vec![r#"{"mesh":0}"#; 500_001].join(",");
    let many = text
        .replace(r#"{"mesh":0,"scale":[1,2,1]}"#, &instances)
        .replace("[1]", &format!("[{}]", nodes.join(",")));
    write("many.glb", &glb(&many, &buffer));
    refused("many.glb", "it has more than 1000000 triangles: simplify it");
}

#[test]
fn in_the_vaulted_hall_the_way_leads_through_the_door_and_the_wall_is_hit() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("courses/nave.toml");
    let course = Course::load(&file).expect("valid");
    let way = course.corridor().expect("through the door");
    let way: Vec<_> = way.iter().map(|[n, e]| [*n, *e, -course.flight_height_m]).collect();
    assert_eq!(fly(&course, &way, 6.0, 1).0, Some(Outcome::Success));
    assert!(course.straight_line_is_blocked());
    let straight = [way[0], [19.0, -2.0, -course.flight_height_m]];
    assert_eq!(fly(&course, &straight, 6.0, 1).0, Some(Outcome::Collision));
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
        let ours = world.collides_at(0, place, Attitude::LEVEL_NORTH);
        assert_eq!(ours, expected.intersecting, "{place:?} {distance_m}");
        touched += u32::from(ours);
    }
    assert!((100..1400).contains(&touched), "{touched}");
}
