//! VIBRATION: how much the accelerometer's readings change from one look to the next.

use crate::service::prelude::*;

const LOOK_NS: Nanos = 10_000_000;
/// Weight of a look in the mean: about a quarter of a second.
const WEIGHT: f32 = 0.04;

#[derive(Debug, Default)]
pub(crate) struct Vibration {
    /// Mean change of the acceleration between two looks, by axis.
    mean_m_s2: [f32; 3],
    due_ns: Nanos,
    last_m_s2: Option<[f32; 3]>,
}

impl Service for Vibration {
    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::stateful(VIBRATION_DATA::ID, [0.0, 0.5, 0.5])] }
    }

    fn produce(&self, _message_id: u32, _link: LinkId, core: &Core) -> Option<MavMessage> {
        let [vibration_x, vibration_y, vibration_z] = self.mean_m_s2;
        // The modelled accelerometer does not clip.
        Some(message!(
            VIBRATION,
            time_usec = core.time_boot_us(),
            vibration_x,
            vibration_y,
            vibration_z
        ))
    }

    fn due_ns(&self) -> Nanos {
        self.due_ns
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + LOOK_NS;
        let reading = core.view.sensors.accelerometer_frd_m_s2.to_array();
        let last = self.last_m_s2.unwrap_or(reading);
        for (mean, (now, last)) in self.mean_m_s2.iter_mut().zip(reading.into_iter().zip(last)) {
            *mean += WEIGHT * ((now - last).abs() - *mean);
        }
        self.last_m_s2 = Some(reading);
    }
}
