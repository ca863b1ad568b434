//! What the motors are told, as pulse widths: ACTUATOR_OUTPUT_STATUS and SERVO_OUTPUT_RAW. 1000 µs is standstill, 2000 µs
//! the top speed; disarmed motors get 900 µs, as PX4 has it.

use crate::core::Core;
use crate::service::{Build, Produced, Service};
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{ACTUATOR_OUTPUT_STATUS_DATA, SERVO_OUTPUT_RAW_DATA};
use vigil_mavlink::mavlink::MessageData;

const DISARMED_US: f32 = 900.0;

pub(crate) struct Actuators;

impl Service for Actuators {
    fn messages(&self) -> &'static [Produced] {
        &[
            Produced {
                id: SERVO_OUTPUT_RAW_DATA::ID,
                rate_hz: [0.0, 1.0, 1.0],
                build: Build::From(servo_outputs),
            },
            Produced {
                id: ACTUATOR_OUTPUT_STATUS_DATA::ID,
                rate_hz: [0.0, 5.0, 0.0],
                build: Build::From(actuator_outputs),
            },
        ]
    }
}

fn pulses_us(core: &Core) -> [f32; 4] {
    if core.view.armed {
        core.view.sensors.motors.map(|share| 1000.0 + 1000.0 * share)
    } else {
        [DISARMED_US; 4]
    }
}

fn actuator_outputs(core: &Core) -> Option<MavMessage> {
    let mut actuator = [0.0; 32];
    for (output, pulse) in actuator.iter_mut().zip(pulses_us(core)) {
        *output = pulse;
    }
    Some(MavMessage::ACTUATOR_OUTPUT_STATUS(ACTUATOR_OUTPUT_STATUS_DATA {
        time_usec: core.time_boot_us(),
        // One bit per motor.
        active: 0b1111,
        actuator,
    }))
}

fn servo_outputs(core: &Core) -> Option<MavMessage> {
    let [servo1_raw, servo2_raw, servo3_raw, servo4_raw] = pulses_us(core).map(|pulse| pulse as u16);
    Some(MavMessage::SERVO_OUTPUT_RAW(SERVO_OUTPUT_RAW_DATA {
        time_usec: core.time_boot_us() as u32,
        servo1_raw,
        servo2_raw,
        servo3_raw,
        servo4_raw,
        ..Default::default()
    }))
}
