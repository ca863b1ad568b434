//! Depth frames from outside: a scanner's packets over UDP, a camera's raw stream and drivers in C and Rust, each by the program or the
//! library that carries it, against the checking command.

#[path = "../../tools/sensors/tests/common/device.rs"]
mod device;
#[path = "../../tools/sensors/tests/common/rays.rs"]
mod rays;

use device::{COLUMN_NS, Device, PER_PACKET};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use vigil_io::background::Background;
use vigil_io::clock::{monotonic_ns, sleep_until};
use vigil_sim::world::{Course, World};
use vigil_tests::{Running, has, refused, root, run, run_line, said, straight_course, succeed, text, vigil};
use vigil_types::files::{Access, replace};
use vigil_types::{Attitude, FrdVector, NedVector, STEP_NS};

/// A wall across the way, 4 m ahead of the start.
fn walled(folder: &Path) -> Course {
    let wall = "[[wall]]\nfrom_m = [4.25, -15.0]\nto_m = [4.25, 15.0]\nthickness_m = 0.5\nheight_m = 10.0\n";
    Course::load(&straight_course(folder, 20.0, wall)).expect("a course")
}

/// An adapter whose output and diagnostics are read line by line.
fn adapter(arguments: &str) -> Running {
    Running::start_saying(arguments, Stdio::piped())
}

/// What `vigil sensor check` finds, as JSON, and its exit code.
fn check(instance: u32, further: &[&str]) -> (Option<i32>, String) {
    let instance = format!("--instance={instance}");
    let output = run(&[&["sensor", "check", &instance, "--seconds=2", "-o", "-"][..], further].concat());
    (output.status.code(), said(&output))
}

/// What a check finds that nothing fails. A busy machine may hold a driver up beyond the age limit, so there are five looks.
fn good(instance: u32, further: &[&str]) -> String {
    let mut last = String::new();
    for _ in 0..5 {
        match check(instance, further) {
            (Some(0), findings) => return findings,
            (_, findings) => last = findings,
        }
    }
    panic!("{last}");
}

/// A scanner that sends one recorded turn again and again, each with fresh stamps, until it is dropped. `spoil` may alter what is sent: given
/// the turn's and the packet's number, it says whether the packet goes out.
fn send(
    turn: Vec<Vec<u8>>,
    port: u16,
    spoil: impl Fn(u16, usize, &mut Vec<u8>) -> bool + Send + 'static,
) -> Background<()> {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
    let (begun_ns, mut number) = (monotonic_ns(), 0u16);
    let started = Background::start("scanner", 1, Duration::ZERO, move |_| {
        for (i, packet) in turn.iter().enumerate() {
            let column_ns = PER_PACKET as u64 * COLUMN_NS;
            let at_ns = begun_ns + u64::from(number) * STEP_NS + (i as u64 + 1) * column_ns;
            let mut packet = packet.clone();
            let block = packet.len() / PER_PACKET;
            for (k, column) in packet.chunks_exact_mut(block).enumerate() {
                let stamp_ns = at_ns - column_ns + k as u64 * COLUMN_NS + 77_000_000_000;
                column[..8].copy_from_slice(&stamp_ns.to_le_bytes());
                column[10..12].copy_from_slice(&number.to_le_bytes());
            }
            sleep_until(at_ns);
            if spoil(number, i, &mut packet) {
                // Nobody may listen yet.
                let _ = socket.send_to(&packet, ("127.0.0.1", port));
            }
        }
        number = number.wrapping_add(1);
    });
    started.expect("a thread")
}

fn recorded(folder: &Path) -> (PathBuf, Vec<Vec<u8>>) {
    let device = Device::new(64, (FrdVector::ZERO, Attitude::LEVEL_NORTH));
    let metadata = folder.join("os0.json");
    std::fs::write(&metadata, device.metadata(true)).expect("written");
    let world = World::new(&walled(folder));
    let pose = (NedVector::new(0.0, 0.0, -1.5), Attitude::LEVEL_NORTH);
    (metadata, device.turn(&world, pose, 0, 100_000_000_000))
}

/// Arguments of an adapter for a scanner that stands still.
fn ouster(metadata: &Path, port: u16, instance: u32) -> String {
    let metadata = text(metadata);
    format!("sensor ouster --metadata {metadata} --listen 127.0.0.1:{port} --still 1.5 --instance {instance}")
}

#[test]
fn a_scanners_packets_over_udp_are_frames_that_the_check_accepts() {
    let folder = tempfile::tempdir().expect("a folder");
    let (metadata, turn) = recorded(folder.path());
    let adapter = adapter(&ouster(&metadata, 17_502, 61));
    let view = adapter.wait_for_words("view ");
    // 64 beams lie 0.94° apart: the outermost row of pixels may have none.
    has(&view, &["-60° to 60° across and -30° to ", "98 %"]);
    adapter.wait_for_words("nothing for");
    let sender = send(turn.clone(), 17502, |_, _, _| true);
    let findings = good(61, &["--wall", "4"]);
    has(&findings, &["are taken", "-60° to 60° across", "4.00 m in the middle"]);
    drop(sender);
    // What is wrong is named, and gives no frame.
    let sender = send(turn, 17502, |number, packet, bytes| {
        if (packet, number % 4) == (31, 2) {
            bytes.truncate(900);
        }
        (packet, number % 4) != (30, 1)
    });
    for words in ["packets were lost, no frame", "a packet of 900 bytes, 12608 expected"] {
        adapter.wait_for_words(words);
    }
    drop(sender);
}

#[test]
fn a_second_adapter_and_metadata_that_cannot_be_used_are_refused_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let (metadata, _) = recorded(folder.path());
    let first = adapter(&ouster(&metadata, 17_503, 62));
    first.wait_for_words("frames ");
    refused(&run_line(&ouster(&metadata, 17_504, 62)), &["already publishes"]);
    let text = std::fs::read_to_string(&metadata).expect("it is there");
    std::fs::write(&metadata, text.replace("LEGACY", "RNG19_RFL8_SIG16_NIR16")).expect("written");
    let other = run_line(&ouster(&metadata, 17_505, 62));
    refused(&other, &["set udp_profile_lidar to LEGACY"]);
}

#[test]
fn a_cameras_recorded_stream_is_published_and_its_broken_end_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let world = World::new(&walled(folder.path()));
    let (width, height, focal) = (160usize, 90usize, 84.0f32);
    let mut recording = Vec::new();
    for image in 0..200u32 {
        for pixel in 0..width * height {
            let (u, v) = ((pixel % width) as f32 - 79.5, (pixel / width) as f32 - 44.5);
            let met = match image {
                0 => rays::cast(&world, NedVector::new(0.0, 0.0, -1.5), NedVector::new(focal, u, v)),
                _ => None,
            };
            let range_m = met.map_or(0.0, |(range_m, _)| range_m as f32);
            let depth_mm = range_m * focal / (focal * focal + u * u + v * v).sqrt() * 1e3;
            recording.extend((depth_mm.round() as u16).to_le_bytes());
        }
    }
    // All images as the first, each a little different.
    let bytes = 2 * width * height;
    for image in 1..200 {
        recording.copy_within(..bytes, image * bytes);
        recording[image * bytes] ^= 1 + image as u8 % 3;
    }
    recording.truncate(200 * bytes - 100);
    let path = folder.path().join("wall.z16");
    std::fs::write(&path, recording).expect("written");
    let adapter = adapter(&format!(
        "sensor z16 {} --size 160,90 --focal 84,84 --centre 79.5,44.5 --rate 30 --still 1.5 --instance 63",
        text(&path)
    ));
    adapter.wait_for_words("warning: where the device does not look");
    let (_, findings) = check(63, &["--wall", "4"]);
    has(&findings, &["4.00 m in the middle", "never returned anything"]);
    adapter.wait_for_words("the stream ended 28700 bytes into an image of 28800");
    adapter.wait_for_words("199 published");
}

/// Compiles the C driver against the library; `None` where there is no C compiler.
fn c_driver(folder: &Path) -> Option<PathBuf> {
    let version = Command::new("cc").arg("--version").output();
    version.ok().filter(|out| out.status.success())?;
    let library = vigil().with_file_name("examples");
    assert!(
        library.join("libvigil_depth.so").is_file(),
        "run `cargo build --release -p vigil-sensors --example vigil_depth`"
    );
    let program = folder.join("publish_wall");
    let sources = root().join("tools/publishers/c");
    let (libraries, headers) = (text(&library), text(&sources));
    let mut compile = Command::new("cc");
    compile.args(["-std=c11", "-Wall", "-Wextra", "-Werror"]);
    compile
        .arg(sources.join("publish_wall.c"))
        .args(["-I", headers, "-L", libraries, "-lvigil_depth"]);
    compile.args([&format!("-Wl,-rpath,{libraries}"), "-o", text(&program)]);
    succeed(&compile.output().expect("cc starts"));
    Some(program)
}

/// A driver's frames with a key and without, as the check sees them.
fn accepted(program: &Path, instance: u32, folder: &Path) {
    let key = folder.join("depth.key");
    replace(&key, &[7; 32], Access::Private).expect("written");
    let key = text(&key);
    for with_key in [false, true] {
        let mut driver = Command::new(program);
        driver.args([&instance.to_string(), "60"]).args(with_key.then_some(key));
        let mut driver = driver.spawn().expect("it starts");
        let further = ["--wall", "2.5", "--frame-key", key];
        let findings = good(instance, if with_key { &further } else { &further[..2] });
        driver.kill().expect("it runs");
        driver.wait().expect("it ends");
        has(&findings, &["2.50 m in the middle"]);
    }
}

#[test]
fn a_driver_in_c_is_accepted_with_a_key_and_without_and_says_what_is_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(program) = c_driver(folder.path()) else {
        println!("left out: there is no C compiler");
        return;
    };
    accepted(&program, 64, folder.path());
    let output = Command::new(&program).args(["64", "1", "/no/such.key"]).output();
    refused(&output.expect("it starts"), &["/no/such.key"]);
    let output = Command::new(&program).args(["100", "1"]).output().expect("it starts");
    assert!(said(&output).contains("from 0 to 99"), "{}", said(&output));
}

#[test]
fn the_driver_in_rust_is_accepted_with_a_key_and_without() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = vigil().with_file_name("examples").join("depth_publisher");
    assert!(program.is_file(), "run `cargo build --release -p vigil-io --examples`");
    accepted(&program, 65, folder.path());
}
