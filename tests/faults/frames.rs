//! Frames that no sensor sends, for three seconds of a flight in lockstep; then the sensor is itself again.

use crate::campaign::{Draw, Ending, Folder, Row, Trial, in_lockstep, joined, spread, tell};
use crate::flight::{Site, collided_anyway};
use anyhow::Result;
use vigil_sim::world::Family;
use vigil_tests::Pair;
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_PIXELS, DepthFrame, GuidanceState, NedVector, Reason, Reasons, STEP_NS, STEP_S,
};

const HOSTILE_STEPS: u64 = 60;
/// A vehicle that sees nothing usable must be ordered to hold within this many steps: half a second.
const MOST_STEPS: u64 = 10;
/// A flight that has not ended after this has not arrived: two minutes.
const FLIGHT_STEPS: u64 = 2400;
const TRIALS: usize = 4;
/// Of the quick part, each so many-th kind.
const QUICK_STRIDE: usize = 6;

/// What must come of a kind.
#[derive(Debug, Clone, Copy)]
enum Must {
    /// Hold in the same step.
    Refuse,
    /// Hold, by one of these names, within half a second.
    Hold(&'static [Reason]),
    /// Nothing: it means no harm.
    Pass,
}

/// What a kind may look at.
struct Seen<'a> {
    /// The good frame before.
    before: &'a DepthFrame,
    /// The good frame at the first hostile step.
    first: &'a DepthFrame,
    now_ns: u64,
    draw: &'a mut Draw,
}

/// Makes a good frame a hostile one.
type Change = fn(&mut DepthFrame, &mut Seen<'_>);

struct Kind {
    name: &'static str,
    must: Must,
    /// Without one nothing arrives.
    change: Option<Change>,
    /// The checksum is made after the change.
    sealed: bool,
}

fn sealed(name: &'static str, must: Must, change: Change) -> Kind {
    let (change, sealed) = (Some(change), true);
    Kind {
        name,
        must,
        change,
        sealed,
    }
}

fn unsealed(name: &'static str, change: Change) -> Kind {
    Kind {
        sealed: false,
        ..sealed(name, Must::Refuse, change)
    }
}

const POSE: Must = Must::Hold(&[Reason::ImplausiblePose]);
const BLIND: Must = Must::Hold(&[Reason::BlindSensor]);
// What is nearer than it was may be taken for an obstacle first.
const PICTURE: Must = Must::Hold(&[
    Reason::BlindSensor,
    Reason::FrozenSensor,
    Reason::InconsistentPicture,
    Reason::CollisionCourse,
    Reason::RoughPicture,
]);
const STALE: Must = Must::Hold(&[Reason::StaleFrame]);

fn one_pixel(frame: &mut DepthFrame, seen: &mut Seen<'_>, value: f32) {
    frame.depth[seen.draw.below(DEPTH_PIXELS)] = value;
}

#[rustfmt::skip]
fn kinds() -> Vec<Kind> {
    use Must::{Pass, Refuse};
    vec![
        // Size.
        sealed("0 rows", Refuse, |f, _| f.header.rows = 0),
        sealed("64 rows", Refuse, |f, _| f.header.rows = 64),
        sealed("65 535 rows", Refuse, |f, _| f.header.rows = u16::MAX),
        sealed("0 columns", Refuse, |f, _| f.header.cols = 0),
        sealed("512 columns", Refuse, |f, _| f.header.cols = 512),
        sealed("rows and columns exchanged", Refuse, |f, _| core::mem::swap(&mut f.header.rows, &mut f.header.cols)),
        // Sensor.
        sealed("sensor 0", Refuse, |f, _| f.header.sensor_id = 0),
        sealed("another sensor", Refuse, |f, _| f.header.sensor_id = 2),
        sealed("sensor 4 294 967 295", Refuse, |f, _| f.header.sensor_id = u32::MAX),
        // Checksum.
        unsealed("checksum 0", |f, _| f.header.checksum = 0),
        unsealed("a flipped bit of the checksum", |f, s| f.header.checksum ^= 1 << s.draw.below(64)),
        unsealed("a pixel changed after the checksum", |f, s| one_pixel(f, s, 0.123)),
        unsealed("a flipped bit of a pixel", |f, s| { let pixel = &mut f.depth[s.draw.below(DEPTH_PIXELS)]; *pixel = f32::from_bits(pixel.to_bits() ^ 1 << s.draw.below(32)); }),
        unsealed("a later stamp after the checksum", |f, _| f.header.stamp_ns += 1),
        unsealed("another sequence after the checksum", |f, _| f.header.sequence += 1),
        unsealed("another position after the checksum", |f, _| f.header.position_ned_m.x += 1.0),
        unsealed("another attitude after the checksum", |f, _| f.header.attitude = Attitude::from_euler_rad(0.0, 0.0, 2.0)),
        unsealed("the checksum of the frame before", |f, s| f.header.checksum = s.before.header.checksum),
        unsealed("torn: the upper half of the frame before", |f, s| f.depth[..DEPTH_PIXELS / 2].copy_from_slice(&s.before.depth[..DEPTH_PIXELS / 2])),
        unsealed("torn: the header of the frame before", |f, s| { let stamp_ns = f.header.stamp_ns; f.header = s.before.header; f.header.stamp_ns = stamp_ns; }),
        // Ranges.
        sealed("a pixel NaN", Refuse, |f, s| one_pixel(f, s, f32::NAN)),
        sealed("the first pixel NaN", Refuse, |f, _| f.depth[0] = f32::NAN),
        sealed("the last pixel NaN", Refuse, |f, _| f.depth[DEPTH_PIXELS - 1] = f32::NAN),
        sealed("all pixels NaN", Refuse, |f, _| f.depth.fill(f32::NAN)),
        sealed("a pixel +inf", Refuse, |f, s| one_pixel(f, s, f32::INFINITY)),
        sealed("a pixel -inf", Refuse, |f, s| one_pixel(f, s, f32::NEG_INFINITY)),
        sealed("all pixels +inf", Refuse, |f, _| f.depth.fill(f32::INFINITY)),
        sealed("a pixel slightly negative", Refuse, |f, s| one_pixel(f, s, -1e-6)),
        sealed("all pixels -1", Refuse, |f, _| f.depth.fill(-1.0)),
        sealed("a pixel slightly above 1", Refuse, |f, s| one_pixel(f, s, 1.0 + f32::EPSILON)),
        sealed("ranges in metres", Refuse, |f, _| f.depth.iter_mut().for_each(|d| *d *= 100.0)),
        sealed("a pixel 1e30", Refuse, |f, s| one_pixel(f, s, 1e30)),
        // Pose.
        sealed("position NaN", Refuse, |f, _| f.header.position_ned_m.y = f32::NAN),
        sealed("position infinite", Refuse, |f, _| f.header.position_ned_m.z = f32::INFINITY),
        sealed("attitude NaN", Refuse, |f, _| f.header.attitude.x = f32::NAN),
        sealed("attitude infinite", Refuse, |f, _| f.header.attitude.w = f32::INFINITY),
        sealed("a quaternion of zeros", Refuse, |f, _| f.header.attitude = Attitude { w: 0.0, x: 0.0, y: 0.0, z: 0.0 }),
        sealed("a quaternion of length 2", Refuse, |f, _| { let a = &mut f.header.attitude; *a = Attitude { w: 2.0 * a.w, x: 2.0 * a.x, y: 2.0 * a.y, z: 2.0 * a.z }; }),
        sealed("position 1e30", POSE, |f, _| f.header.position_ned_m = NedVector::new(1e30, 1e30, 1e30)),
        sealed("position 25 m off", POSE, |f, _| f.header.position_ned_m.x += 25.0),
        sealed("turned by 90 degrees", POSE, |f, _| f.header.attitude = Attitude::from_euler_rad(0.0, 0.0, f.header.attitude.yaw_rad() + core::f32::consts::FRAC_PI_2)),
        sealed("upside down", POSE, |f, _| f.header.attitude = Attitude::from_euler_rad(core::f32::consts::PI, 0.0, f.header.attitude.yaw_rad())),
        // Stamps.
        sealed("stamp 0", Refuse, |f, _| f.header.stamp_ns = 0),
        sealed("the stamp of the frame before", Refuse, |f, s| f.header.stamp_ns = s.before.header.stamp_ns),
        sealed("a stamp that stays", Refuse, |f, s| f.header.stamp_ns = s.first.header.stamp_ns - STEP_NS),
        sealed("a second old", Refuse, |f, _| f.header.stamp_ns -= 20 * STEP_NS),
        sealed("a second ahead", Refuse, |f, s| f.header.stamp_ns = s.now_ns + 20 * STEP_NS),
        sealed("an hour ahead", Refuse, |f, s| f.header.stamp_ns = s.now_ns + 72_000 * STEP_NS),
        sealed("the largest stamp", Refuse, |f, _| f.header.stamp_ns = u64::MAX),
        sealed("the largest signed stamp", Refuse, |f, _| f.header.stamp_ns = i64::MAX as u64),
        // Sequence and what nobody reads.
        sealed("the sequence of the frame before", Pass, |f, s| f.header.sequence = s.before.header.sequence),
        sealed("sequence 0", Pass, |f, _| f.header.sequence = 0),
        sealed("the largest sequence", Pass, |f, _| f.header.sequence = u64::MAX),
        sealed("the reserved field set", Pass, |f, _| f.header.reserved = u32::MAX),
        sealed("a tag where no key is set", Pass, |f, _| f.header.tag.fill(0xA5)),
        // Pictures.
        sealed("all pixels 0", BLIND, |f, _| f.depth.fill(0.0)),
        sealed("all pixels -0", BLIND, |f, _| f.depth.fill(-0.0)),
        sealed("all pixels 1", BLIND, |f, _| f.depth.fill(1.0)),
        sealed("all pixels subnormal", PICTURE, |f, _| f.depth.fill(1e-40)),
        sealed("all pixels 0.02", PICTURE, |f, _| f.depth.fill(0.02)),
        sealed("random ranges", PICTURE, |f, s| f.depth.iter_mut().for_each(|d| *d = s.draw.between(0.0, 1.0) as f32)),
        sealed("a chessboard", PICTURE, |f, _| f.depth.iter_mut().enumerate().for_each(|(i, d)| *d = if (i + i / DEPTH_COLS).is_multiple_of(2) { 0.01 } else { 1.0 })),
        sealed("the picture of the first again", PICTURE, |f, s| f.depth = s.first.depth),
        sealed("upside down picture", PICTURE, |f, _| f.depth.reverse()),
        // Delivery.
        Kind { name: "no frame at all", must: STALE, change: None, sealed: false },
        unsealed("the frame before once more", |f, s| f.clone_from(s.before)),
    ]
}

/// A flight, and the seconds from the first such frame to the hold that came of it.
fn fly(kind: &Kind, seed: u64) -> (Trial, Option<f64>, u64) {
    let mut draw = Draw::new(seed);
    let onset = draw.below(160) as u64 + 10;
    let mut pair = Pair::new(Family::Validation, seed);
    let (mut good, mut before, mut first) = (pair.frame.clone(), pair.frame.clone(), pair.frame.clone());
    let (mut guided, mut hostile) = (0, 0);
    let mut held_after = None;
    let mut reasons = Reasons::NONE;
    let mut wrong = None;
    let mut last = GuidanceState::Standby;
    for _ in 0..FLIGHT_STEPS {
        pair.simulate();
        let now_ns = pair.simulator.now_ns();
        good.clone_from(&pair.frame);
        let is_hostile = guided >= onset && hostile < HOSTILE_STEPS;
        let mut arrives = true;
        if is_hostile {
            if hostile == 0 {
                first.clone_from(&pair.frame);
            }
            hostile += 1;
            let mut seen = Seen {
                before: &before,
                first: &first,
                now_ns,
                draw: &mut draw,
            };
            arrives = kind.change.is_some();
            kind.change.iter().for_each(|change| change(&mut pair.frame, &mut seen));
            if kind.sealed {
                pair.frame.seal();
            }
        }
        let report = pair.decide(arrives);
        core::mem::swap(&mut before, &mut good);
        guided += u64::from(report.state == GuidanceState::Guided);
        last = report.state;
        if is_hostile {
            let holds = report.state == GuidanceState::Hold && !report.reasons.contains(Reason::GoalReached);
            if holds {
                held_after.get_or_insert(hostile - 1);
                reasons = reasons.union(report.reasons);
                let forward_m_s = report.setpoint.map_or(0.0, |setpoint| setpoint.velocity_m_s.x);
                if forward_m_s != 0.0 {
                    wrong = Some(format!("{}: {forward_m_s} m/s asked for while it holds", kind.name));
                }
            }
        }
        if pair.simulator.ending().is_some() {
            break;
        }
    }
    let right = match (kind.must, held_after) {
        // Guidance never engaged.
        _ if hostile == 0 => false,
        (Must::Refuse, Some(0)) => reasons.contains(Reason::BadFrame),
        (Must::Hold(names), Some(steps)) => steps <= MOST_STEPS && names.iter().any(|name| reasons.contains(*name)),
        (Must::Pass, None) => true,
        _ => false,
    };
    if !right {
        wrong.get_or_insert_with(|| {
            let when = held_after.map_or("never".to_owned(), |steps| format!("after {steps} steps"));
            let named: Vec<_> = reasons.iter().map(Reason::name).collect();
            format!("{}, seed {seed}: held {when} ({})", kind.name, named.join(", "))
        });
    }
    let ending = Ending::of(pair.outcome()).unwrap_or(match last {
        GuidanceState::Hold => Ending::Held,
        _ => Ending::TimeOut,
    });
    // A picture may stay in doubt until the motors are off (docs/sensor-faults.md, "How it ends").
    let may_be_held = matches!(kind.must, Must::Hold(names) if names.contains(&Reason::FrozenSensor));
    if ending == Ending::TimeOut || ending == Ending::Held && !may_be_held {
        wrong.get_or_insert_with(|| format!("{}, seed {seed}: does not go on with good frames", kind.name));
    }
    let hold_s = held_after.map(|steps| steps as f64 * f64::from(STEP_S));
    (Trial { ending, wrong }, hold_s, seed)
}

pub fn rows(site: &Site<'_>, _: &Folder) -> Result<Vec<Row>> {
    let mut kinds = kinds();
    let mut trials = TRIALS;
    if site.quick {
        kinds = kinds.into_iter().step_by(QUICK_STRIDE).collect();
        trials = 1;
    } else {
        let count = kinds.len();
        tell(&format!("{count} kinds of hostile frames, {trials} flights each"));
    }
    let group = |must: &Must| match must {
        Must::Refuse => "hostile frames that are refused",
        Must::Hold(_) => "hostile frames that are doubted, or none",
        Must::Pass => "odd frames that do no harm",
    };
    let mut rows = Vec::new();
    for name in [group(&Must::Refuse), group(&Must::Hold(&[])), group(&Must::Pass)] {
        let chosen: Vec<&Kind> = kinds.iter().filter(|kind| group(&kind.must) == name).collect();
        if chosen.is_empty() {
            continue;
        }
        let flown = in_lockstep(site, chosen.len() * trials, |number, seed| {
            fly(chosen[number / trials], seed)
        });
        let trials: Vec<Trial> = flown.iter().map(|(trial, ..)| trial.clone()).collect();
        let holds = flown.iter().filter_map(|(_, hold_s, _)| *hold_s).collect();
        let again = collided_anyway(flown.iter().map(|(trial, _, seed)| (trial, *seed)));
        let measured = [
            format!("{} kinds", chosen.len()),
            spread("hold after", "s", holds),
            again,
        ];
        rows.push(Row::of(name, &trials, joined(measured)));
    }
    Ok(rows)
}
