//! The vehicle's parameters; the protocol that reads and sets them is `services::parameters`.

use std::collections::BTreeMap;
use std::mem::discriminant;
use std::sync::LazyLock;
pub use vigil_mavlink::ParameterValue;

/// What a parameter is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ParameterRole {
    /// The vehicle flies by it.
    Acts,
    /// Taken and sent again, because clients set it; nothing depends on it.
    Kept,
    /// Says what the vehicle is, and cannot be set.
    Fixed,
}

/// What is known of a parameter besides its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterInfo {
    /// Name, at most 16 characters.
    pub name: &'static str,
    /// Default value; its type is the parameter's.
    pub default: ParameterValue,
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// Unit, empty if none.
    pub unit: &'static str,
    /// One line.
    pub description: &'static str,
    /// What it is for.
    pub role: ParameterRole,
}

impl ParameterInfo {
    /// The numbers that stand for something, with what they stand for: those that the description lists (`: 0 nothing, 1 warning`), of
    /// whole numbers. Empty where a number is a quantity.
    pub fn choices(&self) -> Vec<(i32, &'static str)> {
        let (ParameterValue::Integer(_), Some((_, list))) = (self.default, self.description.split_once(": ")) else {
            return Vec::new();
        };
        let choice = |part: &'static str| {
            let (number, name) = part.trim().split_once(' ')?;
            Some((number.parse().ok()?, name))
        };
        let parts = list.split(',');
        parts.map_while(choice).collect()
    }
}

/// Why a parameter was not set.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// No parameter of this name.
    #[error("there is no parameter {0}")]
    Unknown(String),
    /// The parameter of this name cannot be set.
    #[error("{0} cannot be set: it says what the vehicle is")]
    Fixed(&'static str),
    /// The value's type is not that of the parameter of this name.
    #[error("{0} is of another type")]
    WrongType(&'static str),
    /// The value lies outside the limits or is not finite.
    #[error("{name}: {value} is not within {min} to {max}")]
    OutOfRange {
        /// The parameter.
        name: &'static str,
        /// The value asked for.
        value: f64,
        /// Smallest value.
        min: f32,
        /// Largest value.
        max: f32,
    },
}

macro_rules! parameters {
    (acting { $($variant:ident = $name:literal, $kind:ident($default:expr), $min:expr, $max:expr, $unit:literal, $does:literal;)* }
     kept { $($kept:literal, $kept_kind:ident($kept_default:expr), $kept_min:expr, $kept_max:expr, $kept_unit:literal, $why:literal;)* }
     fixed { $($fixed:literal, $fixed_kind:ident($value:expr), $description:literal;)* }) => {
        /// Index of a parameter.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum ParamId { $($variant),* }

        const ACTING: &[ParameterInfo] = &[$(
            ParameterInfo { name: $name, default: ParameterValue::$kind($default), min: $min, max: $max, unit: $unit, description: $does, role: ParameterRole::Acts }
        ),*];

        /// A row of several names stands for one parameter each.
        const SHOWN: &[ParameterInfo] = &[$(
            ParameterInfo { name: $kept, default: ParameterValue::$kept_kind($kept_default), min: $kept_min, max: $kept_max, unit: $kept_unit, description: $why, role: ParameterRole::Kept }
        ,)* $(
            ParameterInfo { name: $fixed, default: ParameterValue::$fixed_kind($value), min: $value as f32, max: $value as f32, unit: "", description: $description, role: ParameterRole::Fixed }
        ),*];
    };
}

// In alphabetical order of their names. Limits are PX4's where scripts set more than this airframe can
// (`crate::vehicle::ControlParams`): the description then says where its own limit lies.
parameters! {
acting {
    DisarmLandS = "COM_DISARM_LAND", Real(2.0), -1.0, 20.0, "s",
        "Time on the ground after a landing until the vehicle disarms itself; 0 or less: never";
    DisarmPreflightS = "COM_DISARM_PRFLT", Real(10.0), -1.0, 60.0, "s",
        "Time armed on the ground without a take-off until the vehicle disarms itself; 0 or less: never";
    FailsafeDelayS = "COM_FAIL_ACT_T", Real(5.0), 0.0, 25.0, "s",
        "Time in hold until NAV_RCL_ACT follows";
    OffboardLossAction = "COM_OBL_RC_ACT", Integer(5), 0.0, 7.0, "",
        "What follows a lost setpoint stream: 0 position, 1 altitude, 2 stabilized (sticks centred if absent), 3 return, 4 land, 5 hold, 6 terminate, 7 disarm";
    OffboardLossS = "COM_OF_LOSS_T", Real(1.0), 0.1, 60.0, "s",
        "Age of the owner's last setpoint at which OFFBOARD is left";
    SticksLossExceptions = "COM_RCL_EXCEPT", Integer(0), 0.0, 31.0, "",
        "Modes that go on when sticks are lost, by bits: bit 0 mission, bit 1 hold and take-off, bit 2 offboard";
    SticksLossS = "COM_RC_LOSS_T", Real(0.5), 0.1, 35.0, "s",
        "Age of the last sticks at which they are lost";
    FollowAltitudeMode = "FLW_TGT_ALT_M", Integer(0), 0.0, 2.0, "",
        "What follow mode counts its height from: 0 home, 1 the ground (the same here), 2 the target";
    FollowDistanceM = "FLW_TGT_DST", Real(8.0), 1.0, 100.0, "m",
        "Horizontal distance that follow mode keeps from the target";
    FollowAngleDeg = "FLW_TGT_FA", Real(180.0), -180.0, 180.0, "deg",
        "Where follow mode keeps itself, clockwise from the target's course: 0 before it, 180 behind it";
    FollowHeightM = "FLW_TGT_HT", Real(8.0), 1.0, 100.0, "m",
        "Height of follow mode";
    FollowSpeedMS = "FLW_TGT_MAX_VEL", Real(5.0), 0.0, 20.0, "m/s",
        "Speed by which follow mode may exceed the target's to get to its place; 3 at most";
    FollowResponsiveness = "FLW_TGT_RS", Real(0.1), 0.0, 1.0, "",
        "How much of the target's former course is kept at each report: 0 none, 1 all";
    FenceAction = "GF_ACTION", Integer(2), 0.0, 5.0, "",
        "What follows when the vehicle leaves its geofence: 0 nothing, 1 warning, 2 hold, 3 return, 4 terminate, 5 land";
    FenceRadiusM = "GF_MAX_HOR_DIST", Real(0.0), 0.0, 10000.0, "m",
        "Largest horizontal distance from home, part of the geofence; 0: none";
    FenceHeightM = "GF_MAX_VER_DIST", Real(0.0), 0.0, 10000.0, "m",
        "Largest height above home, part of the geofence; 0: none";
    TakeoffAltitudeM = "MIS_TAKEOFF_ALT", Real(2.5), 0.5, 80.0, "m",
        "Height that a take-off climbs by when the command gives none";
    LandSlowHeightM = "MPC_LAND_ALT2", Real(5.0), 1.0, 50.0, "m",
        "Height above home below which a landing descends with MPC_LAND_SPEED";
    LandSpeedMS = "MPC_LAND_SPEED", Real(0.7), 0.3, 1.5, "m/s",
        "Rate of descent of the last metres of a landing";
    TakeoffSpeedMS = "MPC_TKO_SPEED", Real(1.5), 0.3, 5.0, "m/s",
        "Rate of climb of a take-off; the airframe's own limit is 2.5";
    CruiseSpeedMS = "MPC_XY_CRUISE", Real(5.0), 0.5, 20.0, "m/s",
        "Horizontal speed of go-to, missions and return; MPC_XY_VEL_MAX at most";
    MaxSpeedMS = "MPC_XY_VEL_MAX", Real(10.0), 0.5, 20.0, "m/s",
        "Limit of horizontal speed; the airframe's own is 10";
    MaxDownMS = "MPC_Z_VEL_MAX_DN", Real(1.5), 0.3, 4.0, "m/s",
        "Limit of the rate of descent of setpoints and sticks; the airframe's own is 1.5";
    MaxUpMS = "MPC_Z_VEL_MAX_UP", Real(2.5), 0.3, 8.0, "m/s",
        "Limit of the rate of climb of setpoints and sticks; the airframe's own is 2.5";
    AutoDownMS = "MPC_Z_V_AUTO_DN", Real(1.5), 0.3, 4.0, "m/s",
        "Rate of descent of a landing above MPC_LAND_ALT2; the airframe's own limit is 1.5";
    AutoUpMS = "MPC_Z_V_AUTO_UP", Real(2.5), 0.3, 8.0, "m/s",
        "Rate of climb of a return; the airframe's own limit is 2.5";
    AcceptanceRadiusM = "NAV_ACC_RAD", Real(2.0), 0.05, 200.0, "m",
        "Distance at which a mission item that gives none is reached";
    HeightAcceptanceM = "NAV_MC_ALT_RAD", Real(0.8), 0.05, 200.0, "m",
        "Height error within which a mission item is reached";
    SticksLossAction = "NAV_RCL_ACT", Integer(2), 0.0, 6.0, "",
        "What follows, after COM_FAIL_ACT_T in hold, lost sticks in a mode that is flown by them: 0 hold, 1 hold, 2 return, 3 land, 4 hold, 5 terminate, 6 disarm";
    ReturnMinDistanceM = "RTL_MIN_DIST", Real(10.0), 0.5, 100.0, "m",
        "Distance from where a return leads within which it climbs no higher than it is away, twice NAV_ACC_RAD at the least";
    ReturnAltitudeM = "RTL_RETURN_ALT", Real(30.0), 0.0, 150.0, "m",
        "Height above home that a return climbs to before it flies home";
    ReturnType = "RTL_TYPE", Integer(0), 0.0, 1.0, "",
        "Where a return flies to: 0 the nearest of home and rally points, 1 the nearest rally point (home if there is none)";
    FailureEnabled = "SYS_FAILURE_EN", Integer(0), 0.0, 1.0, "",
        "Whether INJECT_FAILURE is obeyed: 0 no, 1 yes";
    GuidanceLossS = "VGL_OF_LOSS_T", Real(0.4), 0.1, 60.0, "s",
        "The same as COM_OF_LOSS_T where the owner is the guidance computer, component 191 of the vehicle's system; the shorter counts";
} kept { // Clients set them without asking; nothing depends on them.
    "CBRK_IO_SAFETY", Integer(22027), 0.0, 22027.0, "", "No safety switch";
    "CBRK_SUPPLY_CHK", Integer(0), 0.0, 894281.0, "", "No power check";
    "CBRK_USB_CHK", Integer(197848), 0.0, 197848.0, "", "No USB check";
    "COM_ARM_WO_GPS", Integer(0), 0.0, 2.0, "", "Arming needs the GPS receiver whatever it says";
    "COM_ARM_MAG_STR", Integer(2), 0.0, 2.0, "", "An undisturbed field";
    "COM_DL_LOSS_T", Integer(10), 5.0, 300.0, "s", "See NAV_DLL_ACT";
    "COM_FLTMODE1 COM_FLTMODE2 COM_FLTMODE3 COM_FLTMODE4 COM_FLTMODE5 COM_FLTMODE6", Integer(-1), -1.0, 15.0, "",
        "There is no such switch";
    "COM_MODE_ARM_CHK", Integer(1), 0.0, 1.0, "", "No effect";
    "COM_OBC_LOSS_T", Real(5.0), 0.0, 60.0, "s", "No effect";
    "COM_POSCTL_NAVL", Integer(0), 0.0, 1.0, "", "No effect";
    "COM_POS_FS_EPH", Real(5.0), -1.0, 400.0, "m", "No effect";
    "COM_RC_IN_MODE", Integer(1), 0.0, 8.0, "", "Sticks are taken from MAVLink whatever it says";
    "COM_TAKEOFF_ACT", Integer(0), 0.0, 1.0, "", "A take-off ends in hold";
    "EKF2_BARO_CTRL", Integer(1), 0.0, 1.0, "", "The estimator is modelled by its error: see EKF2_HGT_REF";
    "EKF2_EVP_NOISE", Real(0.1), 0.01, 10.0, "m", "See EKF2_EV_CTRL";
    "EKF2_EV_CTRL", Integer(0), 0.0, 15.0, "",
        "Positions and poses from outside are heard and not used: the estimator is modelled by its error";
    "EKF2_EV_DELAY", Real(0.0), 0.0, 300.0, "ms", "See EKF2_EV_CTRL";
    "EKF2_GPS_CTRL", Integer(7), 0.0, 15.0, "",
        "The estimator is modelled by its error; INJECT_FAILURE takes the receiver away";
    "EKF2_HGT_REF", Integer(1), 0.0, 3.0, "", "The estimator is modelled by its error: no sensor is its reference";
    "GF_PREDICT", Integer(0), 0.0, 1.0, "", "A breach is one when it has happened";
    "LNDMC_TRIG_TIME", Real(1.0), 0.1, 10.0, "s", "No effect";
    "MC_YAWRATE_MAX", Real(200.0), 0.0, 1800.0, "deg/s", "No effect";
    "MIS_DIST_1WP", Real(10_000.0), -1.0, 100_000.0, "m", "A mission's first place may be as far as any other";
    "MIS_TKO_LAND_REQ", Integer(0), 0.0, 6.0, "", "Missions need neither a take-off nor a landing";
    "MPC_ACC_DOWN_MAX MPC_ACC_HOR", Real(3.0), 2.0, 15.0, "m/s^2", "No effect";
    "MPC_ACC_HOR_MAX", Real(5.0), 2.0, 15.0, "m/s^2", "No effect";
    "MPC_JERK_AUTO", Real(4.0), 1.0, 80.0, "m/s^3", "No effect";
    "MPC_JERK_MAX", Real(8.0), 0.5, 500.0, "m/s^3", "No effect";
    "MPC_TILTMAX_AIR", Real(45.0), 20.0, 89.0, "deg", "No effect";
    "MPC_XY_P", Real(0.95), 0.0, 2.0, "", "No effect";
    "SDLOG_MODE", Integer(0), -1.0, 4.0, "", "Flights are logged from arming to disarming";
    "COM_ARM_SDCARD COM_HOME_EN MAV_FWDEXTSP MPC_USE_HTE NAV_FORCE_VT NAV_TRAFF_AVOID", Integer(1), 0.0, 4.0, "", "No effect";
    "COM_CPU_MAX COM_WIND_MAX", Real(-1.0), -1.0, 100.0, "", "No effect";
    "COM_KILL_DISARM", Real(5.0), 0.0, 30.0, "s", "No effect";
    "CP_DELAY", Real(0.4), 0.0, 1.0, "s", "No effect";
    "MC_AIRMODE", Integer(0), 0.0, 2.0, "", "No effect";
    "MC_PITCHRATE_MAX MC_ROLLRATE_MAX", Real(220.0), 0.0, 1800.0, "deg/s", "No effect";
    "MC_PITCHRATE_P MC_ROLLRATE_P", Real(0.15), 0.01, 0.6, "", "No effect";
    "MC_PITCH_P MC_ROLL_P", Real(4.0), 0.0, 12.0, "", "No effect";
    "MC_YAW_P", Real(2.8), 0.0, 5.0, "", "No effect";
    "MIS_YAW_ERR", Real(12.0), 0.0, 90.0, "deg", "No effect";
    "MIS_YAW_TMT", Real(-1.0), -1.0, 20.0, "s", "No effect";
    "MPC_ACC_UP_MAX", Real(4.0), 2.0, 15.0, "m/s^2", "No effect";
    "MPC_LAND_ALT1", Real(10.0), 0.0, 122.0, "m", "No effect";
    "MPC_LAND_CRWL", Real(0.3), 0.1, 5.0, "m/s", "No effect";
    "MPC_MAN_Y_MAX", Real(150.0), 0.0, 400.0, "deg/s", "No effect";
    "MPC_THR_MAX", Real(1.0), 0.0, 1.0, "", "No effect";
    "MPC_THR_MIN", Real(0.12), 0.05, 0.5, "", "No effect";
    "MPC_TILTMAX_LND", Real(12.0), 5.0, 89.0, "deg", "No effect";
    "MPC_TKO_RAMP_T", Real(3.0), 0.0, 5.0, "s", "No effect";
    "MPC_VEL_MANUAL", Real(10.0), 3.0, 20.0, "m/s", "No effect";
    "MPC_XY_VEL_P_ACC", Real(1.8), 1.2, 5.0, "", "No effect";
    "MPC_YAWRAUTO_MAX", Real(60.0), 5.0, 360.0, "deg/s", "No effect";
    "MPC_Z_P", Real(1.0), 0.1, 1.5, "", "No effect";
    "NAV_LOITER_RAD RTL_LOITER_RAD", Real(80.0), -10000.0, 10000.0, "m", "No effect";
    "NAV_MIN_LTR_ALT", Real(-1.0), -1.0, 10000.0, "m", "No effect";
} fixed { // A ground station's set-up pages read what the vehicle is made of.
    "BAT1_A_PER_V", Real(1.0), "Readings are amperes";
    "BAT1_CAPACITY", Real(5000.0), "Capacity in mAh of the default model";
    "BAT1_N_CELLS", Integer(4), "Cells in series";
    "BAT1_SOURCE", Integer(0), "Measured by the power module";
    "BAT1_V_CHARGED", Real(4.2), "Voltage of a full cell";
    "BAT1_V_DIV", Real(1.0), "Readings are volts";
    "BAT1_V_EMPTY", Real(3.3), "Voltage of an empty cell";
    "BAT_CRIT_THR", Real(0.05), "Charge that is reported as critical";
    "BAT_EMERGEN_THR", Real(0.05), "The same as BAT_CRIT_THR";
    "BAT_LOW_THR", Real(0.15), "Charge that is reported as low";
    "CAL_ACC0_ID CAL_GYRO0_ID", Integer(1310988), "The simulated sensor, calibrated";
    "CAL_ACC0_PRIO CAL_GYRO0_PRIO CAL_MAG0_PRIO", Integer(50), "Priority: medium";
    "CAL_ACC1_ID CAL_GYRO1_ID CAL_MAG1_ID", Integer(0), "No second sensor";
    "CAL_ACC2_ID CAL_GYRO2_ID CAL_MAG2_ID", Integer(0), "No third sensor";
    "CAL_BARO0_ID", Integer(6620172), "The simulated sensor";
    "CAL_MAG0_ID", Integer(197388), "The simulated sensor, calibrated";
    "CAL_MAG0_ROT", Integer(-1), "Mounted as the autopilot is";
    "CA_AIRFRAME", Integer(0), "Control allocation: multirotor";
    "CA_ROTOR_COUNT", Integer(4), "Motors";
    "CBRK_FLIGHTTERM", Integer(0), "Flight termination works";
    "COM_LOW_BAT_ACT", Integer(0), "A low battery is reported and nothing else: campaigns end before it matters";
    "COM_RC_OVERRIDE", Integer(0),
        "Moved sticks take over by a mode command alone: what brakes before a wall must not end by a stick held forward";
    "CP_DIST", Real(-1.0), "No collision prevention of its own: that is the guidance computer's";
    "EKF2_MAG_TYPE", Integer(0), "The compass is used";
    "GF_SOURCE", Integer(0), "The geofence is compared with the estimated place";
    "MAV_COMP_ID", Integer(1), "Component id of the autopilot";
    "MAV_SYS_ID", Integer(1), "System id: that of the instance";
    "MAV_TYPE", Integer(2), "MAV_TYPE_QUADROTOR";
    "MC_ACRO_P_MAX MC_ACRO_R_MAX MC_ACRO_Y_MAX", Real(100.0), "Rate at full deflection, degrees per second";
    "MNT_MODE_IN", Integer(-1), "There is no gimbal";
    "MPC_MAN_TILT_MAX", Real(35.0), "Tilt at full deflection, degrees";
    "MPC_POS_MODE", Integer(4), "Position mode shapes accelerations";
    "MPC_THR_HOVER", Real(0.5), "Thrust that hovers";
    "MPC_YAW_MODE", Integer(0), "The nose points along the way";
    "NAV_DLL_ACT", Integer(0), "A lost link has no consequence: nobody needs to be connected";
    "PWM_MAIN_FUNC1", Integer(101), "Output 1 drives motor 1";
    "PWM_MAIN_FUNC2", Integer(102), "Output 2 drives motor 2";
    "PWM_MAIN_FUNC3", Integer(103), "Output 3 drives motor 3";
    "PWM_MAIN_FUNC4", Integer(104), "Output 4 drives motor 4";
    "RC_CHAN_CNT RC_MAP_ARM_SW RC_MAP_AUX1 RC_MAP_AUX2 RC_MAP_FLAPS RC_MAP_FLTMODE RC_MAP_GEAR_SW \
     RC_MAP_KILL_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_PARAM1 RC_MAP_PITCH RC_MAP_RETURN_SW RC_MAP_ROLL \
     RC_MAP_THROTTLE RC_MAP_TRANS_SW RC_MAP_YAW", Integer(0),
        "There is no receiver";
    "RTL_CONE_ANG", Integer(45), "See RTL_MIN_DIST";
    "RTL_DESCEND_ALT", Real(10.0), "See RTL_LAND_DELAY";
    "RTL_LAND_DELAY", Real(0.0), "A return lands at once";
    "SENS_BOARD_ROT", Integer(0), "Mounted straight";
    "SENS_BOARD_X_OFF SENS_BOARD_Y_OFF SENS_BOARD_Z_OFF", Real(0.0), "No offset of the mounting";
    "SENS_DPRES_OFF", Real(0.0), "No airspeed sensor";
    "SYS_AUTOCONFIG", Integer(0), "No reset to the airframe's defaults is due";
    "SYS_AUTOSTART", Integer(4001), "Airframe: a generic quadcopter";
    "SYS_HAS_BARO", Integer(1), "There is a barometer";
    "SYS_HAS_GPS", Integer(1), "There is a GPS receiver";
    "SYS_HAS_MAG", Integer(1), "There is a compass";
    "SYS_HAS_NUM_ASPD", Integer(0), "Airspeed sensors";
    "SYS_HITL", Integer(0), "Not in the loop with another simulator";
    "TRIG_MODE", Integer(0), "There is no camera";
    "UAVCAN_ENABLE", Integer(0), "There is no CAN bus";
} }

/// All parameters in alphabetical order of their names: the index on the wire.
static TABLE: LazyLock<Vec<ParameterInfo>> = LazyLock::new(|| {
    let shown = SHOWN
        .iter()
        .flat_map(|row| row.name.split(' ').map(|name| ParameterInfo { name, ..*row }));
    let mut table: Vec<_> = ACTING.iter().copied().chain(shown).collect();
    table.sort_by_key(|info| info.name);
    table
});

/// Index of each acting parameter, in the order of [`ParamId`].
static PLACES: LazyLock<Vec<usize>> = LazyLock::new(|| {
    let place = |acting: &ParameterInfo| TABLE.iter().position(|info| info.name == acting.name);
    ACTING.iter().filter_map(place).collect()
});

/// All parameters in the order of their index.
pub fn parameter_table() -> &'static [ParameterInfo] {
    &TABLE
}

/// The values in force.
#[derive(Debug, Clone, Default)]
pub(crate) struct Parameters {
    values: Vec<ParameterValue>,
    /// Where the acting ones are among them.
    places: &'static [usize],
}

impl Parameters {
    /// Defaults, then the given values by name.
    pub fn new(overrides: &BTreeMap<String, f64>) -> Result<Self, ParameterError> {
        let mut parameters = Self {
            values: TABLE.iter().map(|info| info.default).collect(),
            places: &PLACES,
        };
        for (name, value) in overrides {
            parameters.set_by_name(name, *value)?;
        }
        Ok(parameters)
    }

    /// Sets a value that a file gives, where whole numbers and fractions look alike.
    pub fn set_by_name(&mut self, name: &str, value: f64) -> Result<(), ParameterError> {
        let index = Self::index_of(name).ok_or_else(|| ParameterError::Unknown(name.to_owned()))?;
        let typed = match TABLE[index].default {
            // A fraction is of another type.
            ParameterValue::Integer(_) if value.fract() == 0.0 => ParameterValue::Integer(value as i32),
            _ => ParameterValue::Real(value as f32),
        };
        self.set(index, typed)
    }

    /// A parameter's value as a float.
    #[inline]
    pub fn get(&self, id: ParamId) -> f32 {
        self.values[self.places[id as usize]].as_f32()
    }

    /// The value at an index of the table.
    pub fn at(&self, index: usize) -> Option<(&'static ParameterInfo, ParameterValue)> {
        Some((TABLE.get(index)?, *self.values.get(index)?))
    }

    /// All of them in the order of their index.
    pub fn all(&self) -> impl Iterator<Item = (&'static ParameterInfo, ParameterValue)> {
        TABLE.iter().zip(self.values.iter().copied())
    }

    /// Gives every one its default again that can be set.
    pub fn reset(&mut self) {
        for (value, info) in self.values.iter_mut().zip(TABLE.iter()) {
            if info.role != ParameterRole::Fixed {
                *value = info.default;
            }
        }
    }

    /// What a parameter that cannot be set says of this vehicle.
    pub fn tell(&mut self, name: &str, value: ParameterValue) {
        if let Some(index) = Self::index_of(name) {
            self.values[index] = value;
        }
    }

    /// Index of a name.
    pub fn index_of(name: &str) -> Option<usize> {
        TABLE.iter().position(|info| info.name == name)
    }

    /// Sets the value at an index of the table after checking its type and limits.
    pub fn set(&mut self, index: usize, value: ParameterValue) -> Result<(), ParameterError> {
        let info = &TABLE[index];
        if discriminant(&info.default) != discriminant(&value) {
            return Err(ParameterError::WrongType(info.name));
        }
        if info.role == ParameterRole::Fixed {
            return match self.values.get(index) == Some(&value) {
                true => Ok(()),
                false => Err(ParameterError::Fixed(info.name)),
            };
        }
        // NaN is in no range.
        if !(info.min..=info.max).contains(&value.as_f32()) {
            return Err(ParameterError::OutOfRange {
                name: info.name,
                value: f64::from(value.as_f32()),
                min: info.min,
                max: info.max,
            });
        }
        self.values[index] = value;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted_fits_the_wire_and_holds_valid_defaults() {
        assert!(TABLE.is_sorted_by(|a, b| a.name < b.name));
        assert!(ACTING.is_sorted_by(|a, b| a.name < b.name));
        let mut parameters = Parameters::new(&BTreeMap::new()).expect("defaults");
        for (index, info) in TABLE.iter().enumerate() {
            assert!(info.name.len() <= 16, "{}", info.name);
            assert_eq!(parameters.set(index, info.default), Ok(()), "{}", info.name);
            assert!(!info.description.is_empty());
        }
        assert_eq!(parameters.get(ParamId::TakeoffAltitudeM), 2.5);
        assert_eq!(TABLE[PLACES[ParamId::ReturnAltitudeM as usize]].name, "RTL_RETURN_ALT");
    }
}
