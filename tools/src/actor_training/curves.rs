//! The learning curves as a picture: reward, success, losses over the updates.

use crate::actor_training::progress::Row;
use crate::report::{Figure, Panel, Picture};

/// The picture as a PNG file's content.
pub fn png(rows: &[Row]) -> Vec<u8> {
    let over = |value: &dyn Fn(&Row) -> Option<f64>| -> Vec<(f64, f64)> {
        rows.iter()
            .filter_map(|r| Some((r.updates as f64, value(r)?)))
            .collect()
    };
    let ended = |r: &Row, v: f64| (r.flights > 0).then_some(v);
    let panels = [
        Panel::new(
            "Reward of training flights",
            "reward (m and bonuses)",
            [("reward", over(&|r| ended(r, f64::from(r.reward))))],
        ),
        Panel::new(
            "Share of flights that reach the goal",
            "share",
            [
                (
                    "training",
                    over(&|r| ended(r, r.successes as f64 / r.flights.max(1) as f64)),
                ),
                ("evaluated, no noise, no field", over(&|r| r.completion)),
            ],
        ),
        Panel::new(
            "Losses",
            "loss",
            [
                ("critic", over(&|r| Some(f64::from(r.update.critic_loss)))),
                ("imitation", over(&|r| Some(f64::from(r.update.imitation_loss)))),
            ],
        ),
        Panel::new(
            "Value of the actor's actions",
            "value",
            [("value", over(&|r| Some(f64::from(r.update.value))))],
        ),
    ];
    let last = rows.last().map_or(1.0, |r| r.updates as f64).max(1.0);
    Figure::over("updates", last, panels.into()).png()
}
