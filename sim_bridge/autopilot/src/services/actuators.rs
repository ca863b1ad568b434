//! What the motors are sent, as pulse widths: ACTUATOR_OUTPUT_STATUS and SERVO_OUTPUT_RAW. 1000 µs is standstill, 2000 µs
//! the top speed; disarmed motors get 900 µs, as PX4 has it. ACTUATOR_TEST shows in these outputs and moves nothing: the
//! propellers are off.

use crate::core::nanos;
use crate::service::prelude::*;
use vigil_mavlink::framing::CommandForm;

const DISARMED_US: f32 = 900.0;

const ACTUATOR_TEST: u16 = 310;
/// Taken, as of missions, although there is nothing that they move: PX4 does not know whether there is.
const DO_SET_ACTUATOR: u16 = 187;
const DO_GRIPPER: u16 = 211;
/// ACTUATOR_OUTPUT_FUNCTION_MOTOR1 to 4.
const MOTORS: core::ops::RangeInclusive<f32> = 1.0..=4.0;
/// PX4's longest test; one without a time lasts as long.
const LONGEST_TEST_S: f32 = 3.0;

#[derive(Default)]
pub(crate) struct Actuators {
    /// Motors that are tried: pulse, and until when.
    tests: [Option<(f32, Nanos)>; 4],
}

impl Service for Actuators {
    fn serves(&self, command: u16) -> bool {
        matches!(command, ACTUATOR_TEST | DO_SET_ACTUATOR | DO_GRIPPER)
    }

    /// Parameter 1 is the output (0 to 1, NaN ends the test), 2 the time in seconds, 5 the motor.
    fn command(&mut self, command: &Command, _source: Source, core: &mut Core) -> Answer {
        if command.number != ACTUATOR_TEST {
            return Ok(());
        }
        if core.commander.armed {
            return Err(Refusal::DENIED.saying("actuator test denied: armed"));
        }
        let function = match command.form {
            CommandForm::Int { x, .. } => Some(x as f32),
            CommandForm::Long { .. } => command.param(5),
        };
        let (output, lasts_s) = (command.param(1), command.param(2));
        let motor = function.filter(|function| MOTORS.contains(function) && function.fract() == 0.0);
        let Some(test) = motor.and_then(|motor| self.tests.get_mut(motor as usize - 1)) else {
            return Err(Refusal::UNSUPPORTED);
        };
        let lasts_s = lasts_s.filter(|s| *s > 0.0).unwrap_or(LONGEST_TEST_S);
        let lasts_ns = nanos(f64::from(lasts_s)).filter(|_| lasts_s <= LONGEST_TEST_S);
        *test = match (output, lasts_ns) {
            (None, _) => None,
            (Some(output), Some(lasts_ns)) if (0.0..=1.0).contains(&output) => {
                Some((1000.0 + 1000.0 * output, core.now_ns + lasts_ns))
            }
            (Some(_), _) => return Err(Refusal::DENIED),
        };
        Ok(())
    }

    fn produce(&self, message_id: u32, _link: LinkId, core: &Core) -> Option<MavMessage> {
        let (pulses_us, now_us) = (self.pulses_us(core), core.time_boot_us());
        if message_id == SERVO_OUTPUT_RAW_DATA::ID {
            let mut m = SERVO_OUTPUT_RAW_DATA::default();
            [m.servo1_raw, m.servo2_raw, m.servo3_raw, m.servo4_raw] = pulses_us.map(|pulse| pulse as u16);
            m.time_usec = now_us as u32;
            return Some(MavMessage::SERVO_OUTPUT_RAW(m));
        }
        let mut actuator = [0.0; 32];
        actuator[..4].copy_from_slice(&pulses_us);
        Some(MavMessage::ACTUATOR_OUTPUT_STATUS(ACTUATOR_OUTPUT_STATUS_DATA {
            time_usec: now_us,
            // One bit per motor.
            active: 0b1111,
            actuator,
        }))
    }

    fn messages(&self) -> &'static [Produced] {
        const {
            &[
                Produced::stateful(SERVO_OUTPUT_RAW_DATA::ID, [0.0, 1.0, 1.0]),
                Produced::stateful(ACTUATOR_OUTPUT_STATUS_DATA::ID, [0.0, 5.0, 0.0]),
            ]
        }
    }
}

impl Actuators {
    fn pulses_us(&self, core: &Core) -> [f32; 4] {
        if core.view.armed {
            return core.view.sensors.motors.map(|share| 1000.0 + 1000.0 * share);
        }
        self.tests.map(|test| match test {
            Some((pulse_us, until_ns)) if core.now_ns <= until_ns => pulse_us,
            _ => DISARMED_US,
        })
    }
}
