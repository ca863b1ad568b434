//! The tables and figures: what each shows, which data it needs, and how it is made of them.

use super::data::Sources;
use super::made::Made;
use super::ours::{alarm_delay, attacked_completion, defences, detection, families, peers, vehicles};
use super::paper::{
    contributions, figure_9, figure_10, figure_11, pixels_of_a_flight, sum_and_action, table_1, table_2, table_3,
    table_4,
};
use anyhow::Result;

/// A table or a figure.
pub struct Item {
    pub id: &'static str,
    pub title: &'static str,
    units: &'static str,
    /// Makes it; fails where data are missing, damaged or of something else.
    pub make: fn(&Sources) -> Result<Made>,
}

/// Without its title.
const fn item(id: &'static str, make: fn(&Sources) -> Result<Made>, units: &'static str) -> Item {
    Item {
        id,
        title: "",
        units,
        make,
    }
}

impl Item {
    /// The units of data that it needs.
    pub fn units(&self) -> impl Iterator<Item = &'static str> {
        self.units.split(' ')
    }

    const fn called(self, title: &'static str) -> Self {
        Self { title, ..self }
    }
}

/// In the order of the page: the paper's, then ours.
pub const ITEMS: [Item; 17] = [
    item("table-1", table_1, "training-runs attack-completion")
        .called("Table I: training with and without the potential field, completion of validation courses"),
    item("table-2", table_2, "attack-deflection").called("Table II: yaw deflection in front of a wall"),
    item("table-3", table_3, "detector-table").called("Table III: detection by four detectors on the same states"),
    item("table-4", table_4, "detector-times").called("Table IV: time of deciding, explaining and scoring"),
    item("figure-9", figure_9, "training-runs").called("Figure 9: reward of the training flights"),
    item("figure-10", figure_10, "training-runs")
        .called("Figure 10: share of the last ten training flights that reached the goal"),
    item("figure-11", figure_11, "attack-table")
        .called("Figure 11: states deceived, and deflection of the yaw, over the strength of the attack"),
    item("figure-12", pixels_of_a_flight, "explained")
        .called("Figure 12: depth frames and the SHAP values of their pixels"),
    item("figure-13", contributions, "explained-attacked")
        .called("Figure 13: SHAP values of image, bearing and distance over an attacked flight"),
    item("figure-14", sum_and_action, "explained-attacked")
        .called("Figure 14: the sum of the SHAP values against the action"),
    item("attacked-completion", attacked_completion, "attack-completion")
        .called("Completion under short attacks, with and without the potential field"),
    item("roc", detection, "detector-evaluate").called("Receiver operating characteristic of LSTM-AD, by attack"),
    item("alarm-delay", alarm_delay, "detector-evaluate").called("How soon LSTM-AD notices an attack, and forgets it"),
    item(
        "defences",
        defences,
        "defended-100 defended-continuous defended-adaptive defended-adaptive-unguarded",
    )
    .called("Attackers against defences"),
    item(
        "families",
        families,
        "family-training family-validation family-dense family-hard",
    )
    .called("Completion by course family, whole stack"),
    item(
        "vehicles",
        vehicles,
        "vehicle-ours vehicle-px4-light vehicle-px4-sih vehicle-arducopter",
    )
    .called("Completion by vehicle model with a noisy estimate, whole stack"),
    item("peers", peers, "peers").called("Time of other programs for the same work"),
];
