//! A scanner's packets, made by code of its own, become the image that the LiDAR model takes from the same place; what is wrong with
//! packets is named and gives no frame.

#[path = "common/device.rs"]
mod device;
#[path = "common/rays.rs"]
mod rays;

use device::{COLUMNS, Device, PER_PACKET};
use vigil_sensors::Mount;
use vigil_sensors::adapters::{Fault, OusterAdapter, OusterDevice, SetupError};
use vigil_sim::world::{Family, Lidar, LidarConfig, Shot, World, generate};
use vigil_types::{Attitude, DEPTH_COLS, DEPTH_PIXELS, DepthFrame, FrdVector, Nanos, NedVector};

const STEP_NS: Nanos = 50_000_000;
const START_NS: Nanos = 200_000_000_000;

fn mount() -> (FrdVector, Attitude) {
    let turn = Attitude::from_euler_rad(0.0, 0.1, 0.0);
    (FrdVector::new(0.08, 0.0, -0.06), turn)
}

/// The adapter for a device as its metadata describe it.
fn adapter(device: &Device, in_groups: bool) -> OusterAdapter {
    let described = OusterDevice::from_metadata(&device.metadata(in_groups)).expect("metadata");
    let (position, turn) = device.mount;
    OusterAdapter::new(described, Mount::new(position, turn).unwrap()).expect("an adapter")
}

struct Bench {
    device: Device,
    adapter: OusterAdapter,
    world: World,
    pose: (NedVector, Attitude),
    depth: Box<[f32; DEPTH_PIXELS]>,
}

impl Bench {
    fn new(beams: usize, seed: u64) -> Self {
        let course = generate(Family::Validation, seed);
        let device = Device::new(beams, mount());
        let start = course.start_ned_m();
        Self {
            adapter: adapter(&device, seed.is_multiple_of(2)),
            device,
            world: World::new(&course),
            pose: (
                NedVector::new(start.x, start.y, -course.flight_height_m),
                Attitude::from_euler_rad(0.04, -0.06, 0.1),
            ),
            depth: Box::new([1.0; DEPTH_PIXELS]),
        }
    }

    /// A turn's packets, the machine's clock reading `START_NS` + `number` steps in its middle.
    fn turn(&self, number: u16) -> Vec<Vec<u8>> {
        self.device
            .turn(&self.world, self.pose, number, START_NS + u64::from(number) * STEP_NS)
    }

    /// Hands packets over as they would arrive, 0.2 ms after their last column; what came of it but for nothing.
    fn feed(&mut self, number: u16, packets: &[Vec<u8>]) -> Vec<Result<Nanos, Fault>> {
        let middle_ns = START_NS + u64::from(number) * STEP_NS;
        let mut out = Vec::new();
        for (i, packet) in packets.iter().enumerate() {
            let arrived_ns = middle_ns + (i as u64 + 1) * PER_PACKET as u64 * device::COLUMN_NS - 25_000_000 + 200_000;
            out.extend(self.adapter.packet(packet, arrived_ns, &mut self.depth).transpose());
        }
        out
    }

    /// A whole turn, handed over.
    fn turned(&mut self, number: u16) -> Vec<Result<Nanos, Fault>> {
        let packets = self.turn(number);
        self.feed(number, &packets)
    }

    /// Hands over a turn that lacks something and the next one, which is whole; columns that were then missing, and those needed.
    fn lost(&mut self, number: u16, holed: &[Vec<u8>]) -> (usize, usize) {
        assert_eq!(self.feed(number, holed), [], "it may still come");
        let after = self.turned(number + 1);
        let [Err(Fault::LostColumns { missing, needed }), Ok(_)] = after[..] else {
            panic!("{after:?}")
        };
        (missing, needed)
    }
}

#[test]
fn recorded_packets_of_a_course_become_the_lidar_models_image_with_the_stamp_of_its_middle() {
    for (beams, seed) in [(128, 7), (64, 8)] {
        let mut bench = Bench::new(beams, seed);
        let view = bench.adapter.view;
        assert!(view.is_some_and(|v| v.is_whole()), "{view:?}");
        assert_eq!(bench.adapter.packet_bytes(), 16 * (16 + 12 * beams + 4));
        let taken = (0..3).flat_map(|n| bench.turned(n));
        let stamps: Vec<Nanos> = taken.map(|taken| taken.expect("a frame")).collect();
        assert_eq!(stamps.len(), 3, "one a turn");
        for (n, stamp_ns) in stamps.iter().enumerate() {
            let error_ns = *stamp_ns as i64 - (START_NS + n as u64 * STEP_NS) as i64;
            let is_near = (0..1_500_000).contains(&error_ns);
            assert!(is_near, "a stamp is {error_ns} ns beside the middle of the turn");
        }
        let shot = Shot::at(bench.pose.0, bench.pose.1);
        let mut lidar = Box::new(DepthFrame::EMPTY);
        let mut model = Lidar::new(LidarConfig::ideal(), 1).unwrap();
        model.capture(&bench.world, &shot, &mut lidar);
        // Where the model sees one surface, away from the image's border.
        let mut errors_m = Vec::new();
        for pixel in (4 * DEPTH_COLS..120 * DEPTH_COLS).filter(|p| (4..252).contains(&(p % DEPTH_COLS))) {
            let around = [pixel - 2, pixel + 2, pixel - 2 * DEPTH_COLS, pixel + 2 * DEPTH_COLS];
            let here = lidar.depth[pixel];
            let is_smooth = here < 1.0 && around.iter().all(|p| (lidar.depth[*p] - here).abs() < 0.1 * here);
            if is_smooth {
                errors_m.push((bench.depth[pixel] - here).abs() * 100.0);
            }
        }
        errors_m.sort_by(f32::total_cmp);
        let pixels = errors_m.len();
        let within = errors_m.iter().filter(|e| **e <= 0.3).count() as f32 / pixels as f32;
        let median_m = errors_m[pixels / 2];
        let found = format!("median {median_m} m, {within} within 0.3 m of {pixels} pixels");
        println!("{beams} beams, course {seed}: {found}");
        assert!(pixels > 5000 && median_m < 0.02 && within > 0.97, "{found}");
    }
}

#[test]
fn a_turn_with_a_lost_packet_is_no_frame_and_the_next_one_is() {
    let mut bench = Bench::new(64, 7);
    assert!(matches!(bench.turned(0)[..], [Ok(_)]));
    let mut holed = bench.turn(1);
    holed.remove(COLUMNS / PER_PACKET / 2);
    let (missing, needed) = bench.lost(1, &holed);
    assert!(missing == 16 && (340..420).contains(&needed), "{missing} of {needed}");
    // Behind the vehicle nothing is needed.
    let mut holed = bench.turn(3);
    holed.remove(2);
    assert!(matches!(bench.feed(3, &holed)[..], [Ok(_)]));
}

/// From a sensor ahead of the middle what is near at the view's border lies farther to the side than what is far there.
#[test]
fn a_turn_without_columns_in_which_only_near_things_are_in_view_is_no_frame() {
    let mut bench = Bench::new(64, 7);
    let mount = (FrdVector::new(0.3, 0.0, 0.0), Attitude::LEVEL_NORTH);
    bench.device = Device::new(64, mount);
    bench.adapter = adapter(&bench.device, false);
    let mut holed = bench.turn(0);
    // 73° to 79° to the left.
    holed.remove(18);
    assert_eq!(bench.lost(0, &holed).0, PER_PACKET);
}

#[test]
fn packets_out_of_order_within_a_turn_are_as_good_and_late_ones_are_named() {
    let mut bench = Bench::new(64, 7);
    let (first, mut second) = (bench.turn(0), bench.turn(1));
    bench.feed(0, &first);
    second.swap(30, 31);
    assert!(matches!(bench.feed(1, &second)[..], [Ok(_)]));
    assert_eq!(bench.feed(1, &first[40..41]), [Err(Fault::LatePacket)]);
}

#[test]
fn a_column_that_the_device_calls_bad_counts_as_lost() {
    let mut bench = Bench::new(64, 7);
    let mut turn = bench.turn(0);
    let len = turn[32].len();
    turn[32][len - 1] = 0;
    assert_eq!(bench.lost(0, &turn).0, 1);
}

#[test]
fn what_is_not_the_devices_packet_is_named_and_disturbs_nothing() {
    let mut bench = Bench::new(64, 7);
    let turn = bench.turn(0);
    let mut given = turn.clone();
    let mut shuffled = turn[5].clone();
    shuffled[8] ^= 0x40;
    let mut beyond = turn[5].clone();
    beyond[9] = 0x7f;
    given.insert(20, turn[19][..12_000].to_vec());
    given.insert(21, Vec::new());
    given.insert(22, shuffled);
    given.insert(23, beyond);
    let taken = bench.feed(0, &given);
    let length = |got| -> Result<Nanos, Fault> { Err(Fault::PacketLength { got, expected: 12_608 }) };
    assert_eq!(taken[..2], [length(12_000), length(0)]);
    assert_eq!(taken[2..4], [Err(Fault::PacketContent); 2]);
    assert!(matches!(taken[4..], [Ok(_)]), "{taken:?}");
}

#[test]
fn a_clock_that_goes_back_and_packets_held_up_are_no_frames() {
    let mut bench = Bench::new(64, 7);
    for n in 0..3 {
        assert!(matches!(bench.turned(n)[..], [Ok(_)]));
    }
    bench.device.clock_ns -= 10_000_000_000;
    assert!(matches!(bench.turned(3)[..], [Err(Fault::ClockBack(_))]));
    assert!(matches!(bench.turned(4)[..], [Ok(_)]));
    // Packets whose stamps are 0.2 s older than they were.
    let turn = bench.turn(5);
    assert!(matches!(bench.feed(9, &turn)[..], [Err(Fault::ClockBehind(behind_s))] if (behind_s - 0.2).abs() < 0.01));
    let after = bench.turned(10);
    let goes_on = matches!(after[..], [Err(Fault::LostColumns { .. }), Ok(_)]);
    assert!(goes_on, "{after:?}");
}

#[test]
fn an_empty_sky_all_around_is_named() {
    let mut bench = Bench::new(64, 7);
    bench.pose.0.z = -5000.0;
    assert_eq!(bench.turned(0), [Err(Fault::EmptyImage)]);
}

#[test]
fn a_sensor_that_looks_elsewhere_or_begins_its_turns_ahead_is_refused_at_the_start() {
    let device = || OusterDevice::from_metadata(&Device::new(64, mount()).metadata(false)).unwrap();
    let turned = |pitch: f32, yaw: f32| {
        let turn = Attitude::from_euler_rad(0.0, pitch.to_radians(), yaw.to_radians());
        OusterAdapter::new(device(), Mount::new(FrdVector::ZERO, turn).unwrap()).err()
    };
    assert_eq!(turned(0.0, 180.0), Some(SetupError::TurnBeginsInView));
    assert_eq!(turned(0.0, 20.0), None);
}

#[test]
fn metadata_that_cannot_be_used_says_what_is_missing() {
    let good = Device::new(64, mount()).metadata(false);
    for (from, to, word) in [
        ("LEGACY", "RNG19_RFL8_SIG16_NIR16", "LEGACY"),
        ("1024x20", "1000x20", "lidar_mode"),
        ("1024x20", "1024x7", "lidar_mode"),
        ("_column\": 64", "_column\": 32", "pixels_per_column"),
        ("azimuth_angles\": [", "azimuth_angles\": [0.5, ", "beam_azimuth_angles"),
        ("transform\": [-1,", "transform\": [", "lidar_to_sensor_transform"),
        ("lidar_origin_to", "origin_to", "mm` is missing: update"),
        ("_packet\": 16", "_packet\": 15", "columns_per_packet"),
    ] {
        assert!(good.contains(from), "{from}");
        let error = OusterDevice::from_metadata(&good.replace(from, to)).expect_err(from);
        assert!(error.to_string().contains(word), "{from}: {error}");
    }
    let page = OusterDevice::from_metadata("<html>").expect_err("a page").to_string();
    assert!(page.starts_with("the metadata file is no JSON: "), "{page}");
}
