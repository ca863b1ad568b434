//! What a setpoint asks for: which masks and frames are flown, and which values are absurd.

use crate::geo;
use crate::vehicle::{ControlCommand, Goal, Held, YawCommand};
use vigil_mavlink::common::{
    AttitudeTargetTypemask as AttitudeMask, MavFrame, PositionTargetTypemask as PositionMask, SET_ATTITUDE_TARGET_DATA,
    SET_POSITION_TARGET_GLOBAL_INT_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vigil_types::{Attitude, FrdVector, HeadingVector, NedVector};

/// Beyond these a value is a mistake, not a wish: the setpoint is refused rather than limited.
const ABSURD_POSITION_M: f32 = 100_000.0;
const ABSURD_VELOCITY_M_S: f32 = 100.0;
const ABSURD_ACCELERATION_M_S2: f32 = 100.0;
const ABSURD_RATE_RAD_S: f32 = 100.0;

/// Why a setpoint is not flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum SetpointDefect {
    #[error("frame {0} is not flown")]
    Frame(u8),
    /// SET_ACTUATOR_CONTROL_TARGET.
    #[error("actuators are not flown")]
    Actuators,
    #[error("frame 8 has no positions")]
    PositionInBodyFrame,
    #[error("mask {0:#05x} is not flown")]
    Mask(u16),
    /// An axis without the others: PX4 takes such a setpoint, stays in OFFBOARD, and does not fly it.
    #[error("mask {0:#05x} lacks axes: held")]
    Incomplete(u16),
    /// A field that the mask uses.
    #[error("{0} is NaN or absurd")]
    Value(&'static str),
}

/// Which axes of a setpoint are used.
const ALL: [bool; 3] = [true, true, true];
const NONE: [bool; 3] = [false, false, false];
const HORIZONTAL: [bool; 3] = [true, true, false];
const VERTICAL: [bool; 3] = [false, false, true];

/// Whether the used ones of some fields are within the limit.
fn check<const N: usize>(
    used: [bool; N],
    names: [&'static str; N],
    values: [f32; N],
    limit: f32,
) -> Result<(), SetpointDefect> {
    let mut fields = used.into_iter().zip(names).zip(values);
    // Written so that NaN is beyond it.
    match fields.find(|((is_used, _), value)| *is_used && !(0.0..=limit).contains(&value.abs())) {
        None => Ok(()),
        Some(((_, name), _)) => Err(SetpointDefect::Value(name)),
    }
}

/// The axes of position, velocity and acceleration that a setpoint uses, whose values are sound.
fn used_axes(m: &SET_POSITION_TARGET_LOCAL_NED_DATA, is_local: bool) -> Result<[[bool; 3]; 3], SetpointDefect> {
    let (p, v, a) = ([m.x, m.y, m.z], [m.vx, m.vy, m.vz], [m.afx, m.afy, m.afz]);
    // A NaN is a field that is left out. The bits of the second and third axis follow that of the first.
    let used = |first: PositionMask, values: [f32; 3]| {
        [0, 1, 2].map(|axis| m.type_mask.bits() & first.bits() << axis == 0 && !values[axis].is_nan())
    };
    let mut position = used(PositionMask::POSITION_TARGET_TYPEMASK_X_IGNORE, p);
    let mut velocity = used(PositionMask::POSITION_TARGET_TYPEMASK_VX_IGNORE, v);
    let mut acceleration = used(PositionMask::POSITION_TARGET_TYPEMASK_AX_IGNORE, a);
    if !is_local {
        // What is turned is turned as a whole.
        velocity = if velocity == ALL { ALL } else { NONE };
        acceleration = if acceleration == ALL { ALL } else { NONE };
        if position != NONE && velocity == NONE && acceleration == NONE {
            return Err(SetpointDefect::PositionInBodyFrame);
        }
        position = NONE;
    }
    if acceleration != NONE && m.type_mask.contains(PositionMask::POSITION_TARGET_TYPEMASK_FORCE_SET) {
        return Err(SetpointDefect::Mask(m.type_mask.bits()));
    }
    check(position, ["x", "y", "z"], p, ABSURD_POSITION_M)?;
    check(velocity, ["vx", "vy", "vz"], v, ABSURD_VELOCITY_M_S)?;
    check(acceleration, ["afx", "afy", "afz"], a, ABSURD_ACCELERATION_M_S2)?;
    Ok([position, velocity, acceleration])
}

/// What a SET_POSITION_TARGET_LOCAL_NED asks for. Frames 1 and 8 as in PX4: frame 8 is turned by yaw alone and has no
/// positions; `heading_rad` is the vehicle's now. An acceleration beside a position or velocity is a feed-forward: the
/// vehicle's own shaping makes one, so it is checked and not used.
pub(crate) fn position_setpoint(
    m: &SET_POSITION_TARGET_LOCAL_NED_DATA,
    speed_limit_m_s: f32,
    heading_rad: f32,
) -> Result<ControlCommand, SetpointDefect> {
    let is_local = match m.coordinate_frame {
        MavFrame::MAV_FRAME_LOCAL_NED => true,
        MavFrame::MAV_FRAME_BODY_NED => false,
        other => return Err(SetpointDefect::Frame(other as u8)),
    };
    let [position, velocity, acceleration] = used_axes(m, is_local)?;
    let ignores = |field| m.type_mask.contains(field);
    let yaw = if !ignores(PositionMask::POSITION_TARGET_TYPEMASK_YAW_IGNORE) && !m.yaw.is_nan() {
        check([true], ["yaw"], [m.yaw], ABSURD_RATE_RAD_S)?;
        YawCommand::Angle(m.yaw)
    } else if !ignores(PositionMask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE) && !m.yaw_rate.is_nan() {
        check([true], ["yaw_rate"], [m.yaw_rate], ABSURD_RATE_RAD_S)?;
        YawCommand::Rate(m.yaw_rate)
    } else {
        YawCommand::Hold
    };
    let velocity_ned = NedVector::new(m.vx, m.vy, m.vz);
    let goal = |held, (x, y, z), velocity_m_s, speed_limit_m_s| {
        Ok(ControlCommand::Position(Goal {
            held,
            velocity_m_s,
            ..Goal::new(NedVector::new(x, y, z), yaw, speed_limit_m_s)
        }))
    };
    match (position, velocity) {
        (ALL, ALL) if is_local => goal(Held::All, (m.x, m.y, m.z), velocity_ned, speed_limit_m_s),
        (ALL, _) if is_local => goal(Held::All, (m.x, m.y, m.z), NedVector::ZERO, speed_limit_m_s),
        (VERTICAL, HORIZONTAL | ALL) if is_local => goal(Held::Height, (0.0, 0.0, m.z), velocity_ned, f32::INFINITY),
        (HORIZONTAL, VERTICAL) if is_local => {
            let climb = NedVector::new(0.0, 0.0, m.vz);
            goal(Held::Level, (m.x, m.y, 0.0), climb, speed_limit_m_s)
        }
        (NONE, ALL) if is_local => Ok(ControlCommand::VelocityNed(velocity_ned, yaw)),
        (NONE, ALL) => Ok(ControlCommand::VelocityHeading(
            HeadingVector::new(m.vx, m.vy, m.vz),
            yaw,
        )),
        (NONE, NONE) if acceleration == ALL => {
            let acceleration_ned_m_s2 = match is_local {
                true => NedVector::new(m.afx, m.afy, m.afz),
                false => HeadingVector::new(m.afx, m.afy, m.afz).to_ned(heading_rad),
            };
            Ok(ControlCommand::Acceleration(acceleration_ned_m_s2, yaw))
        }
        (NONE, NONE) if acceleration == NONE => Err(SetpointDefect::Mask(m.type_mask.bits())),
        _ => Err(SetpointDefect::Incomplete(m.type_mask.bits())),
    }
}

/// What a SET_POSITION_TARGET_GLOBAL_INT asks for: the same with a place on the globe, its altitude above sea level
/// (frame 5), above home (6) or above the level ground (11). PX4 refuses the frames of before, 0 and 3, and a place that is not whole
/// is none.
pub(crate) fn global_setpoint(
    m: &SET_POSITION_TARGET_GLOBAL_INT_DATA,
    speed_limit_m_s: f32,
) -> Result<ControlCommand, SetpointDefect> {
    let place = PositionMask::from_bits_retain(0x007);
    let is_placed = !m.type_mask.intersects(place);
    let height_m = match m.coordinate_frame {
        MavFrame::MAV_FRAME_GLOBAL_INT => geo::height_m(m.alt),
        MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT | MavFrame::MAV_FRAME_GLOBAL_TERRAIN_ALT_INT => m.alt,
        other if is_placed => return Err(SetpointDefect::Frame(other as u8)),
        _ => 0.0,
    };
    let (x, y) = geo::ORIGIN.north_east_m(f64::from(m.lat_int) * 1e-7, f64::from(m.lon_int) * 1e-7);
    let local = SET_POSITION_TARGET_LOCAL_NED_DATA {
        x,
        y,
        z: -height_m,
        vx: m.vx,
        vy: m.vy,
        vz: m.vz,
        afx: m.afx,
        afy: m.afy,
        afz: m.afz,
        yaw: m.yaw,
        yaw_rate: m.yaw_rate,
        type_mask: if is_placed { m.type_mask } else { m.type_mask | place },
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    };
    position_setpoint(&local, speed_limit_m_s, 0.0).map_err(|defect| match defect {
        SetpointDefect::Value("x") => SetpointDefect::Value("lat_int"),
        SetpointDefect::Value("y") => SetpointDefect::Value("lon_int"),
        SetpointDefect::Value("z") => SetpointDefect::Value("alt"),
        other => other,
    })
}

/// What a SET_ATTITUDE_TARGET asks for: attitude and thrust, with a yaw rate if it has one, or body rates and thrust.
pub(crate) fn attitude_setpoint(m: &SET_ATTITUDE_TARGET_DATA) -> Result<ControlCommand, SetpointDefect> {
    let rates = AttitudeMask::ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
        | AttitudeMask::ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
        | AttitudeMask::ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE;
    let no_thrust =
        AttitudeMask::ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE | AttitudeMask::ATTITUDE_TARGET_TYPEMASK_THRUST_BODY_SET;
    let not_flown = SetpointDefect::Mask(u16::from(m.type_mask.bits()));
    if m.type_mask.intersects(no_thrust) {
        return Err(not_flown);
    }
    if !(0.0..=1.0).contains(&m.thrust) {
        return Err(SetpointDefect::Value("thrust"));
    }
    let ignores = |field| m.type_mask.contains(field);
    if !ignores(AttitudeMask::ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE) {
        let turns = !ignores(AttitudeMask::ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE);
        check([turns], ["body_yaw_rate"], [m.body_yaw_rate], ABSURD_RATE_RAD_S)?;
        let [w, x, y, z] = m.q;
        let attitude = Attitude { w, x, y, z };
        if !attitude.is_valid() {
            return Err(SetpointDefect::Value("q"));
        }
        let yaw_rate_rad_s = if turns { m.body_yaw_rate } else { 0.0 };
        return Ok(ControlCommand::Attitude(attitude, yaw_rate_rad_s, m.thrust));
    }
    if m.type_mask.intersects(rates) {
        return Err(not_flown);
    }
    let wanted = [m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate];
    let names = ["body_roll_rate", "body_pitch_rate", "body_yaw_rate"];
    check(ALL, names, wanted, ABSURD_RATE_RAD_S)?;
    let [p, q, r] = wanted;
    Ok(ControlCommand::Rates(FrdVector::new(p, q, r), m.thrust))
}

#[cfg(test)]
mod tests {
    use super::*;
    use SET_POSITION_TARGET_LOCAL_NED_DATA as Setpoint;

    fn ned(frame: MavFrame, mask: u16) -> Setpoint {
        Setpoint {
            x: 1.0,
            y: 2.0,
            z: -3.0,
            vx: 0.5,
            vy: -0.5,
            vz: 0.1,
            yaw: 0.7,
            yaw_rate: 0.2,
            type_mask: PositionMask::from_bits_retain(mask),
            coordinate_frame: frame,
            ..Default::default()
        }
    }

    fn read(frame: MavFrame, mask: u16) -> Result<ControlCommand, SetpointDefect> {
        position_setpoint(&ned(frame, mask), 5.0, 0.0)
    }

    #[test]
    fn masks_mean_what_they_say_and_can_be_mixed_as_in_px4() {
        use MavFrame::{MAV_FRAME_BODY_NED as BODY, MAV_FRAME_LOCAL_NED as LOCAL};
        let rate = YawCommand::Rate(0.2);
        let (angle, held) = (YawCommand::Angle(0.7), YawCommand::Hold);
        let velocity_m_s = NedVector::new(0.5, -0.5, 0.1);
        let ahead = ControlCommand::VelocityHeading(HeadingVector::new(0.5, -0.5, 0.1), rate);
        let north = |yaw| ControlCommand::VelocityNed(velocity_m_s, yaw);
        let goal = |held, position_ned_m, velocity_m_s, yaw, speed_limit_m_s| {
            ControlCommand::Position(Goal {
                held,
                velocity_m_s,
                ..Goal::new(position_ned_m, yaw, speed_limit_m_s)
            })
        };
        let position = |velocity| goal(Held::All, NedVector::new(1.0, 2.0, -3.0), velocity, angle, 5.0);
        let height = NedVector::new(0.0, 0.0, -3.0);
        let at_height = goal(Held::Height, height, velocity_m_s, held, f32::INFINITY);
        let rising = NedVector::new(0.0, 0.0, 0.1);
        let climb = goal(Held::Level, NedVector::new(1.0, 2.0, 0.0), rising, held, 5.0);
        let read = |frame, mask, heading_rad| {
            let mut m = ned(frame, mask);
            (m.afx, m.afy, m.afz) = (1.0, 0.0, -0.5);
            position_setpoint(&m, 5.0, heading_rad)
        };
        for (frame, mask, wanted) in [
            (BODY, 0x5C7, ahead),
            (LOCAL, 0x9C7, north(angle)),
            (LOCAL, 0xC07, north(held)),
            (LOCAL, 0x9F8, position(NedVector::ZERO)),
            (LOCAL, 0x9C0, position(velocity_m_s)),
            (LOCAL, 0, position(velocity_m_s)),
            (LOCAL, 0x800, position(velocity_m_s)),
            (LOCAL, 0xDE3, at_height),
            (LOCAL, 0xDDC, climb),
        ] {
            assert_eq!(read(frame, mask, 0.0), Ok(wanted), "{mask:#x}");
        }
        for (frame, heading_rad, north, east) in
            [(LOCAL, 1.0, 1.0, 0.0), (BODY, core::f32::consts::FRAC_PI_2, 0.0, 1.0)]
        {
            let taken = read(frame, 0xC3F, heading_rad);
            let Ok(ControlCommand::Acceleration(a, YawCommand::Hold)) = taken else {
                panic!("{taken:?}");
            };
            let is_turned = (a.x - north).abs() < 1e-6 && (a.y - east).abs() < 1e-6;
            assert!(is_turned && a.z == -0.5, "{a:?}");
        }
    }

    #[test]
    fn what_the_vehicle_does_not_fly_is_refused_not_guessed() {
        use MavFrame::{MAV_FRAME_BODY_NED as BODY, MAV_FRAME_LOCAL_NED as LOCAL};
        // A force; nothing at all; a heading alone.
        for mask in [0xE3F, 0xFFF, 0xBFF] {
            assert_eq!(read(LOCAL, mask), Err(SetpointDefect::Mask(mask)));
        }
        // Half a velocity; half a position; half an acceleration. Half a velocity or acceleration beside a position is none.
        for mask in [0x5D7, 0x5FB, 0xCBF] {
            assert_eq!(read(LOCAL, mask), Err(SetpointDefect::Incomplete(mask)));
        }
        assert_eq!(read(LOCAL, 0x9C8), read(LOCAL, 0x9F8));
        assert_eq!(read(LOCAL, 0x8B8), read(LOCAL, 0x9F8));
        // Along the heading half a velocity is none either, and a place beside a whole one.
        assert_eq!(read(BODY, 0x5D7), Err(SetpointDefect::Mask(0x5D7)));
        assert_eq!(read(BODY, 0x5C0), read(BODY, 0x5C7));
        // A NaN is left out.
        type Change = fn(&mut Setpoint, f32);
        let with = |mut m: Setpoint, value: f32, change: Change| {
            change(&mut m, value);
            position_setpoint(&m, 5.0, 0.0)
        };
        let with_nan = |change: Change| with(ned(LOCAL, 0x9C0), f32::NAN, change);
        assert_eq!(with_nan(|m, nan| (m.x, m.y, m.z) = (nan, nan, nan)), read(LOCAL, 0x9C7));
        assert_eq!(with_nan(|m, nan| m.yaw = nan), read(LOCAL, 0xDC0));
        let held = Err(SetpointDefect::Incomplete(0x9C0));
        assert_eq!(with_nan(|m, nan| (m.z, m.vz) = (nan, nan)), held);
        for bad in [f32::INFINITY, 1e9] {
            let with_bad = |change: Change| with(ned(BODY, 0x5C7), bad, change);
            let refused = |field| Err(SetpointDefect::Value(field));
            assert_eq!(with_bad(|m, bad| m.vy = bad), refused("vy"));
            assert_eq!(with_bad(|m, bad| m.yaw_rate = bad), refused("yaw_rate"));
            // A field that the mask ignores may hold anything: MAVSDK sends NaN there.
            assert_eq!(with_bad(|m, bad| m.x = bad), read(BODY, 0x5C7));
        }
    }

    #[test]
    fn a_place_on_the_globe_is_flown_to_as_the_local_point_it_is() {
        let (lat, lon, _) = geo::to_global(NedVector::new(40.0, -30.0, 0.0));
        let read = |coordinate_frame, lat_int, alt, mask| {
            let m = SET_POSITION_TARGET_GLOBAL_INT_DATA {
                lat_int,
                lon_int: lon,
                alt,
                type_mask: PositionMask::from_bits_retain(mask),
                coordinate_frame,
                ..Default::default()
            };
            global_setpoint(&m, 5.0)
        };
        let wanted = NedVector::new(40.0, -30.0, -7.0);
        // Above the ground is above home.
        for (frame, alt) in [
            (MavFrame::MAV_FRAME_GLOBAL_INT, 495.0),
            (MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 7.0),
            (MavFrame::MAV_FRAME_GLOBAL_TERRAIN_ALT_INT, 7.0),
        ] {
            match read(frame, lat, alt, 0x9F8) {
                Ok(ControlCommand::Position(goal)) => assert!((goal.position_ned_m - wanted).norm() < 0.05, "{goal:?}"),
                other => panic!("{other:?}"),
            }
        }
        // On the other side of the globe: absurd.
        let absurd = read(MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, -lat, 7.0, 0x9F8);
        assert_eq!(absurd, Err(SetpointDefect::Value("lat_int")));
        let frame_0 = MavFrame::MAV_FRAME_GLOBAL;
        assert_eq!(read(frame_0, -lat, 7.0, 0x9F8), Err(SetpointDefect::Frame(0)));
        // A place that is not whole is none, in whatever frame.
        assert_eq!(read(frame_0, -lat, 7.0, 0xDC4), Ok(ControlCommand::STOP));
    }

    #[test]
    fn attitude_targets_are_attitude_or_rates_with_thrust() {
        let target = |mask: u8| SET_ATTITUDE_TARGET_DATA {
            q: [1.0, 0.0, 0.0, 0.0],
            body_yaw_rate: 0.3,
            thrust: 0.5,
            type_mask: AttitudeMask::from_bits_retain(mask),
            ..Default::default()
        };
        let attitude = ControlCommand::Attitude(Attitude::LEVEL_NORTH, 0.0, 0.5);
        assert_eq!(attitude_setpoint(&target(0x07)), Ok(attitude));
        let rates = ControlCommand::Rates(FrdVector::new(0.0, 0.0, 0.3), 0.5);
        assert_eq!(attitude_setpoint(&target(0x80)), Ok(rates));
        for mask in [0x47, 0x27, 0x87] {
            let refused = Err(SetpointDefect::Mask(u16::from(mask)));
            assert_eq!(attitude_setpoint(&target(mask)), refused);
        }
        let (mut skewed, mut unknown) = (target(0x07), target(0x80));
        skewed.q = [0.5, 0.0, 0.0, 0.0];
        unknown.body_pitch_rate = f32::NAN;
        for (bad, field) in [(skewed, "q"), (unknown, "body_pitch_rate")] {
            assert_eq!(attitude_setpoint(&bad), Err(SetpointDefect::Value(field)));
        }
    }
}
