//! Frames that no sensor sends, for three seconds of a flight in lockstep; then the sensor is itself again.

use crate::campaign::{Draw, Ending, Folder, Row, Trial, in_lockstep, joined, spread, tell};
use crate::flight::{Site, collided_anyway};
use anyhow::Result;
use vigil_sim::world::Family;
use vigil_tests::{Pair, reasons};
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_PIXELS, DepthFrame, GuidanceState, NedVector, Reason, STEP_NS, STEP_S, StepReport,
};

const HOSTILE_STEPS: usize = 60;
/// A vehicle that sees nothing usable must be ordered to hold within this many steps: half a second.
const MOST_STEPS: usize = 10;
/// A flight that has not ended after this has not arrived: two minutes.
const FLIGHT_STEPS: usize = 2400;
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

/// How a changed frame arrives.
#[derive(Clone, Copy, PartialEq)]
enum Delivery {
    /// With its checksum made after the change.
    Sealed,
    Unsealed,
    /// Nothing arrives.
    Lost,
}

type Kind = (&'static str, Must, Delivery, Change);

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
const KINDS: &[Kind] = {
    use Delivery::{Lost, Sealed, Unsealed};
    use Must::{Pass, Refuse};
    &[
        // Size.
        ("0 rows", Refuse, Sealed, |f, _| f.header.rows = 0),
        ("64 rows", Refuse, Sealed, |f, _| f.header.rows = 64),
        ("65 535 rows", Refuse, Sealed, |f, _| f.header.rows = u16::MAX),
        ("0 columns", Refuse, Sealed, |f, _| f.header.cols = 0),
        ("512 columns", Refuse, Sealed, |f, _| f.header.cols = 512),
        ("rows and columns exchanged", Refuse, Sealed, |f, _| core::mem::swap(&mut f.header.rows, &mut f.header.cols)),
        // Sensor.
        ("sensor 0", Refuse, Sealed, |f, _| f.header.sensor_id = 0),
        ("another sensor", Refuse, Sealed, |f, _| f.header.sensor_id = 2),
        ("sensor 4 294 967 295", Refuse, Sealed, |f, _| f.header.sensor_id = u32::MAX),
        // Checksum.
        ("checksum 0", Refuse, Unsealed, |f, _| f.header.checksum = 0),
        ("a flipped bit of the checksum", Refuse, Unsealed, |f, s| f.header.checksum ^= 1 << s.draw.below(64)),
        ("a pixel changed after the checksum", Refuse, Unsealed, |f, s| one_pixel(f, s, 0.123)),
        ("a flipped bit of a pixel", Refuse, Unsealed, |f, s| { let pixel = &mut f.depth[s.draw.below(DEPTH_PIXELS)]; *pixel = f32::from_bits(pixel.to_bits() ^ 1 << s.draw.below(32)); }),
        ("a later stamp after the checksum", Refuse, Unsealed, |f, _| f.header.stamp_ns += 1),
        ("another sequence after the checksum", Refuse, Unsealed, |f, _| f.header.sequence += 1),
        ("another position after the checksum", Refuse, Unsealed, |f, _| f.header.position_ned_m.x += 1.0),
        ("another attitude after the checksum", Refuse, Unsealed, |f, _| f.header.attitude = Attitude::from_euler_rad(0.0, 0.0, 2.0)),
        ("the checksum of the frame before", Refuse, Unsealed, |f, s| f.header.checksum = s.before.header.checksum),
        ("torn: the upper half of the frame before", Refuse, Unsealed, |f, s| f.depth[..DEPTH_PIXELS / 2].copy_from_slice(&s.before.depth[..DEPTH_PIXELS / 2])),
        ("torn: the header of the frame before", Refuse, Unsealed, |f, s| { let stamp_ns = f.header.stamp_ns; f.header = s.before.header; f.header.stamp_ns = stamp_ns; }),
        // Ranges.
        ("a pixel NaN", Refuse, Sealed, |f, s| one_pixel(f, s, f32::NAN)),
        ("the first pixel NaN", Refuse, Sealed, |f, _| f.depth[0] = f32::NAN),
        ("the last pixel NaN", Refuse, Sealed, |f, _| f.depth[DEPTH_PIXELS - 1] = f32::NAN),
        ("all pixels NaN", Refuse, Sealed, |f, _| f.depth.fill(f32::NAN)),
        ("a pixel +inf", Refuse, Sealed, |f, s| one_pixel(f, s, f32::INFINITY)),
        ("a pixel -inf", Refuse, Sealed, |f, s| one_pixel(f, s, f32::NEG_INFINITY)),
        ("all pixels +inf", Refuse, Sealed, |f, _| f.depth.fill(f32::INFINITY)),
        ("a pixel slightly negative", Refuse, Sealed, |f, s| one_pixel(f, s, -1e-6)),
        ("all pixels -1", Refuse, Sealed, |f, _| f.depth.fill(-1.0)),
        ("a pixel slightly above 1", Refuse, Sealed, |f, s| one_pixel(f, s, 1.0 + f32::EPSILON)),
        ("ranges in metres", Refuse, Sealed, |f, _| f.depth.iter_mut().for_each(|d| *d *= 100.0)),
        ("a pixel 1e30", Refuse, Sealed, |f, s| one_pixel(f, s, 1e30)),
        // Pose.
        ("position NaN", Refuse, Sealed, |f, _| f.header.position_ned_m.y = f32::NAN),
        ("position infinite", Refuse, Sealed, |f, _| f.header.position_ned_m.z = f32::INFINITY),
        ("attitude NaN", Refuse, Sealed, |f, _| f.header.attitude.x = f32::NAN),
        ("attitude infinite", Refuse, Sealed, |f, _| f.header.attitude.w = f32::INFINITY),
        ("a quaternion of zeros", Refuse, Sealed,
            |f, _| f.header.attitude = Attitude { w: 0.0, x: 0.0, y: 0.0, z: 0.0 }),
        ("a quaternion of length 2", Refuse, Sealed, |f, _| { let a = &mut f.header.attitude; *a = Attitude { w: 2.0 * a.w, x: 2.0 * a.x, y: 2.0 * a.y, z: 2.0 * a.z }; }),
        ("position 1e30", POSE, Sealed, |f, _| f.header.position_ned_m = NedVector::new(1e30, 1e30, 1e30)),
        ("position 25 m off", POSE, Sealed, |f, _| f.header.position_ned_m.x += 25.0),
        ("turned by 90 degrees", POSE, Sealed, |f, _| f.header.attitude = Attitude::from_euler_rad(0.0, 0.0, f.header.attitude.yaw_rad() + core::f32::consts::FRAC_PI_2)),
        ("upside down", POSE, Sealed, |f, _| f.header.attitude = Attitude::from_euler_rad(core::f32::consts::PI, 0.0, f.header.attitude.yaw_rad())),
        // Stamps.
        ("stamp 0", Refuse, Sealed, |f, _| f.header.stamp_ns = 0),
        ("the stamp of the frame before", Refuse, Sealed, |f, s| f.header.stamp_ns = s.before.header.stamp_ns),
        ("a stamp that stays", Refuse, Sealed, |f, s| f.header.stamp_ns = s.first.header.stamp_ns - STEP_NS),
        ("a second old", Refuse, Sealed, |f, _| f.header.stamp_ns -= 20 * STEP_NS),
        ("a second ahead", Refuse, Sealed, |f, s| f.header.stamp_ns = s.now_ns + 20 * STEP_NS),
        ("an hour ahead", Refuse, Sealed, |f, s| f.header.stamp_ns = s.now_ns + 72_000 * STEP_NS),
        ("the largest stamp", Refuse, Sealed, |f, _| f.header.stamp_ns = u64::MAX),
        ("the largest signed stamp", Refuse, Sealed, |f, _| f.header.stamp_ns = i64::MAX as u64),
        // Sequence and what nobody reads.
        ("the sequence of the frame before", Pass, Sealed, |f, s| f.header.sequence = s.before.header.sequence),
        ("sequence 0", Pass, Sealed, |f, _| f.header.sequence = 0),
        ("the largest sequence", Pass, Sealed, |f, _| f.header.sequence = u64::MAX),
        ("the reserved field set", Pass, Sealed, |f, _| f.header.reserved = u32::MAX),
        ("a tag where no key is set", Pass, Sealed, |f, _| f.header.tag.fill(0xA5)),
        // Pictures.
        ("all pixels 0", BLIND, Sealed, |f, _| f.depth.fill(0.0)),
        ("all pixels -0", BLIND, Sealed, |f, _| f.depth.fill(-0.0)),
        ("all pixels 1", BLIND, Sealed, |f, _| f.depth.fill(1.0)),
        ("all pixels subnormal", PICTURE, Sealed, |f, _| f.depth.fill(1e-40)),
        ("all pixels 0.02", PICTURE, Sealed, |f, _| f.depth.fill(0.02)),
        ("random ranges", PICTURE, Sealed,
            |f, s| f.depth.iter_mut().for_each(|d| *d = s.draw.between(0.0, 1.0) as f32)),
        ("a chessboard", PICTURE, Sealed, |f, _| f.depth.iter_mut().enumerate().for_each(|(i, d)| *d = if (i + i / DEPTH_COLS).is_multiple_of(2) { 0.01 } else { 1.0 })),
        ("the picture of the first again", PICTURE, Sealed, |f, s| f.depth = s.first.depth),
        ("upside down picture", PICTURE, Sealed, |f, _| f.depth.reverse()),
        // Delivery.
        ("no frame at all", STALE, Lost, |_, _| {}),
        ("the frame before once more", Refuse, Unsealed, |f, s| f.clone_from(s.before)),
    ]
};

/// A flight, and the seconds from the first such frame to the hold that came of it.
fn fly((name, must, delivery, change): Kind, seed: u64) -> (Trial, Option<f64>, u64) {
    let mut draw = Draw::new(seed);
    let onset = draw.below(160) + 10;
    let mut pair = Pair::new(Family::Validation, seed);
    let before_it = pair.fly_guided(onset, FLIGHT_STEPS);
    let (mut good, mut before, mut first) = (pair.frame.clone(), pair.frame.clone(), pair.frame.clone());
    let hostile = pair.fly(HOSTILE_STEPS.min(FLIGHT_STEPS - before_it), |pair, step| {
        good.clone_from(&pair.frame);
        if step == 0 {
            first.clone_from(&pair.frame);
        }
        let mut seen = Seen {
            before: &before,
            first: &first,
            now_ns: pair.simulator.now_ns(),
            draw: &mut draw,
        };
        change(&mut pair.frame, &mut seen);
        if delivery == Delivery::Sealed {
            pair.frame.seal();
        }
        core::mem::swap(&mut before, &mut good);
        delivery != Delivery::Lost
    });
    let after = pair.fly(FLIGHT_STEPS - before_it - hostile.len(), |_, _| true);
    let holds = |r: &StepReport| r.state == GuidanceState::Hold && !r.reasons.contains(Reason::GoalReached);
    let held_after = hostile.iter().position(holds);
    let held: Vec<StepReport> = hostile.iter().copied().filter(holds).collect();
    let reasons = reasons(&held);
    let asked_m_s = held
        .iter()
        .map(|r| r.setpoint.map_or(0.0, |setpoint| setpoint.velocity_m_s.x));
    let forward_m_s = asked_m_s.rev().find(|forward_m_s| *forward_m_s != 0.0);
    let mut wrong = forward_m_s.map(|forward_m_s| format!("{name}: {forward_m_s} m/s asked for while it holds"));
    let right = match (must, held_after) {
        // Guidance never engaged.
        _ if hostile.is_empty() => false,
        (Must::Refuse, Some(0)) => reasons.contains(Reason::BadFrame),
        (Must::Hold(names), Some(steps)) => steps <= MOST_STEPS && names.iter().any(|name| reasons.contains(*name)),
        (Must::Pass, None) => true,
        _ => false,
    };
    if !right {
        wrong.get_or_insert_with(|| {
            let when = held_after.map_or("never".to_owned(), |steps| format!("after {steps} steps"));
            let named: Vec<_> = reasons.iter().map(Reason::name).collect();
            format!("{name}, seed {seed}: held {when} ({})", named.join(", "))
        });
    }
    let ending = Ending::of(pair.outcome()).unwrap_or(match after.last().or(hostile.last()) {
        Some(last) if last.state == GuidanceState::Hold => Ending::Held,
        _ => Ending::TimeOut,
    });
    // A picture may stay in doubt until the motors are off (docs/sensor-faults.md, "How it ends").
    let may_be_held = matches!(must, Must::Hold(names) if names.contains(&Reason::FrozenSensor));
    if ending == Ending::TimeOut || ending == Ending::Held && !may_be_held {
        wrong.get_or_insert_with(|| format!("{name}, seed {seed}: does not go on with good frames"));
    }
    let hold_s = held_after.map(|steps| steps as f64 * f64::from(STEP_S));
    (Trial { ending, wrong }, hold_s, seed)
}

pub fn rows(site: &Site<'_>, _: &Folder) -> Result<Vec<Row>> {
    let (stride, trials) = if site.quick { (QUICK_STRIDE, 1) } else { (1, TRIALS) };
    if !site.quick {
        let count = KINDS.len();
        tell(&format!("{count} kinds of hostile frames, {trials} flights each"));
    }
    let group = |must| match must {
        Must::Refuse => "hostile frames that are refused",
        Must::Hold(_) => "hostile frames that are doubted, or none",
        Must::Pass => "odd frames that do no harm",
    };
    let mut rows = Vec::new();
    for name in [Must::Refuse, Must::Hold(&[]), Must::Pass].map(group) {
        let kinds = KINDS.iter().step_by(stride);
        let chosen: Vec<&Kind> = kinds.filter(|(_, must, ..)| group(*must) == name).collect();
        if chosen.is_empty() {
            continue;
        }
        let flown = in_lockstep(site, chosen.len() * trials, |number, seed| {
            fly(*chosen[number / trials], seed)
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
