//! Rally points: places to return to besides home. <https://mavlink.io/en/services/mission.html#rally-points>

use crate::plan::{PlanDefect, PlanItem};

const NAV_RALLY_POINT: u16 = 5100;

/// The rally points: metres north and east of the local origin.
#[derive(Debug, Default)]
pub(crate) struct Rally(Vec<(f32, f32)>);

impl Rally {
    pub fn new(items: &[PlanItem]) -> Result<Self, PlanDefect> {
        items.iter().map(Self::read).collect::<Result<_, _>>().map(Self)
    }

    /// The point that an item stands for, metres north and east of the local origin.
    pub fn read(item: &PlanItem) -> Result<(f32, f32), PlanDefect> {
        if item.command != NAV_RALLY_POINT {
            return Err(PlanDefect::unsupported("not a rally point"));
        }
        item.point()
    }

    /// The point to return to: home or a rally point, whichever is nearest, as PX4 chooses with RTL_TYPE 0. `rally_first`
    /// takes home only where there is no rally point (RTL_TYPE 1).
    pub fn nearest_m(&self, (north_m, east_m): (f32, f32), home_m: (f32, f32), rally_first: bool) -> (f32, f32) {
        let distance = |(n, e): (f32, f32)| libm::hypotf(n - north_m, e - east_m);
        let first = if rally_first { self.0.first() } else { None };
        let nearer = |best, point: &_| {
            if distance(*point) < distance(best) {
                *point
            } else {
                best
            }
        };
        self.0.iter().fold(*first.unwrap_or(&home_m), nearer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_of_home_and_rally_points_is_returned_to() {
        let mut rally = Rally::default();
        let home = (0.0, 0.0);
        assert_eq!(rally.nearest_m((30.0, 40.0), home, false), home);
        rally.0 = vec![(30.0, 0.0), (0.0, 30.0)];
        assert_eq!(rally.nearest_m((20.0, 1.0), home, false), (30.0, 0.0));
        assert_eq!(rally.nearest_m((-1.0, 20.0), home, false), (0.0, 30.0));
        assert_eq!(rally.nearest_m((5.0, 5.0), home, false), home);
        assert_eq!(rally.nearest_m((5.0, 5.0), home, true), (30.0, 0.0));
        assert_eq!(Rally::default().nearest_m((5.0, 5.0), home, true), home);
        let moved = (20.0, 4.0);
        assert_eq!(rally.nearest_m((20.0, 1.0), moved, false), moved);
    }
}
