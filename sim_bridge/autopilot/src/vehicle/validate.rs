//! Which parameters the model can fly, and the error that says which it cannot.

use crate::vehicle::params::{GRAVITY_M_S2, VehicleParams, Wind};
use vigil_types::settings::{self, Outside, Section};

/// A vehicle parameter that no vehicle can have.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("vehicle parameter `{0}` is {1}; it must be {2}")]
pub struct ParamsError(String, f64, String);

/// The first number that is not finite or out of range, by its path, its value and what is accepted.
fn check<S: Section + Clone>(settings: &S, path: &str) -> Result<(), ParamsError> {
    let error = |Outside { key, value, range }| ParamsError(format!("{path}{key}"), value, format!("from {range}"));
    settings::check(settings).map_err(error)
}

impl VehicleParams {
    /// Whether the model can fly these parameters.
    ///
    /// # Errors
    /// Names the first field that is not finite or out of range, its value and what is accepted.
    pub fn validate(&self) -> Result<(), ParamsError> {
        check(self, "")?;
        let (m, g, b, a) = (&self.motors, &self.ground, &self.battery, &self.airframe);
        let mass_kg = a.mass_kg;
        let top_thrust_n = 4.0 * m.thrust_coefficient_n_s2 * m.max_speed_rad_s * m.max_speed_rad_s;
        let foot_m2 = a.gear_half_track_m * a.gear_half_track_m + a.gear_height_m * a.gear_height_m;
        let least_inertia_kg_m2 = a.inertia_kg_m2.into_iter().fold(f64::INFINITY, f64::min);
        // Explicit integration at 1 ms bounds what the ground may be made of.
        let rows = [
            (
                "motors.idle_speed_rad_s",
                m.idle_speed_rad_s,
                (0.0, 0.5 * m.max_speed_rad_s),
                "from 0 to half of motors.max_speed_rad_s",
            ),
            (
                "motors (thrust-to-weight ratio)",
                top_thrust_n / (mass_kg * GRAVITY_M_S2),
                (1.2, 20.0),
                "from 1.2 to 20: raise or lower motors.max_speed_rad_s, motors.thrust_coefficient_n_s2 or airframe.mass_kg",
            ),
            (
                "ground.stiffness_n_m",
                g.stiffness_n_m / mass_kg,
                (100.0, 10_000.0),
                "from 100 to 10 000 N/m per kilogram of mass",
            ),
            (
                "ground.damping_n_s_m",
                g.damping_n_s_m / mass_kg,
                (1.0, 100.0),
                "from 1 to 100 N per m/s per kilogram of mass",
            ),
            (
                "ground.damping_n_s_m",
                g.damping_n_s_m / g.stiffness_n_m,
                (1e-3, f64::INFINITY),
                "at least 0.001 N per m/s per N/m of ground.stiffness_n_m",
            ),
            (
                "airframe.inertia_kg_m2 (against ground.damping_n_s_m)",
                4.0 * g.damping_n_s_m * foot_m2 / least_inertia_kg_m2,
                (0.0, 1500.0),
                "at most 1500: raise the least inertia, or lower ground.damping_n_s_m, airframe.gear_half_track_m or \
                 airframe.gear_height_m",
            ),
            (
                "battery.full_v",
                b.full_v,
                (b.empty_v, 1000.0),
                "from battery.empty_v to 1000 V",
            ),
        ];
        // A NaN lies in no range.
        match rows
            .into_iter()
            .find(|(_, value, (low, high), _)| !(low..=high).contains(&value))
        {
            Some((field, value, _, must_be)) => Err(ParamsError(field.to_owned(), value, must_be.to_owned())),
            None => Ok(()),
        }
    }
}

impl Wind {
    /// Whether this wind is one the model can fly in.
    ///
    /// # Errors
    /// Names the first field that is not finite or out of range.
    pub fn validate(&self) -> Result<(), ParamsError> {
        check(self, "wind.")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_survive_a_file() {
        let params = VehicleParams::default();
        params.validate().unwrap();
        Wind::CALM.validate().unwrap();
        let text = settings::to_toml(&params);
        assert_eq!(settings::from_toml::<VehicleParams>(&text), Ok(params));
    }

    #[test]
    fn a_law_that_there_is_not_is_refused_with_those_there_are() {
        let error = settings::from_toml::<VehicleParams>("[control]\nhold = \"stay\"").unwrap_err();
        assert!(
            error.contains("line 2") && error.contains("stop, fly_back, brake"),
            "{error}"
        );
    }

    #[test]
    fn a_refused_value_is_named_with_what_is_accepted() {
        let refused = |change: fn(&mut VehicleParams), reason: &str| {
            let mut params = VehicleParams::default();
            change(&mut params);
            let error = params.validate().unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        };
        let weightless = |p: &mut VehicleParams| p.airframe.mass_kg = f64::NAN;
        refused(weightless, "`airframe.mass_kg` is NaN; it must be from 0.1 to 50 kg");
        refused(|p| p.motors.max_speed_rad_s = 700.0, "thrust-to-weight");
        // Ground contact that swings up by itself at 1 ms.
        let swings = |p: &mut VehicleParams| (p.ground.stiffness_n_m, p.ground.damping_n_s_m) = (20_000.0, 10.0);
        refused(swings, "N/m of ground.stiffness_n_m");
        refused(|p| p.airframe.inertia_kg_m2[1] = 0.004, "`airframe.inertia_kg_m2");

        let wind = Wind {
            mean_ned_m_s: [0.0, f64::INFINITY, 0.0],
            ..Wind::CALM
        };
        assert!(wind.validate().unwrap_err().to_string().contains("`wind.mean_ned_m_s"));
    }
}
