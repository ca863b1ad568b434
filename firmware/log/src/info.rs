//! Who flew with which settings: the metadata at the start of a log.

use crate::log_file::LOG_FORMAT;
use std::collections::BTreeMap;

/// What a log says about its flight besides the records.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FlightInfo {
    /// Name and version of the program that flew, for example `firmware 0.2.0`.
    pub program: String,
    /// Source revision it was built from, if known.
    pub git_commit: Option<String>,
    /// Number of the vehicle instance.
    pub instance: u32,
    /// Seed of the simulated flight, if it has one.
    pub seed: Option<u64>,
    /// Digest of the actor that flew, if one did.
    pub actor_sha256: Option<String>,
    /// Digest of the detector that monitored it, if one did.
    pub detector_sha256: Option<String>,
    /// Score above which its verdict was attack.
    pub detector_threshold: Option<f32>,
    /// The whole configuration as TOML: what a replay builds its flight stack from.
    pub config_toml: String,
}

const FORMAT: &str = "format";
const EPOCH_OFFSET: &str = "epoch_offset_ns";

impl FlightInfo {
    pub(crate) fn to_metadata(&self, epoch_offset_ns: u64) -> BTreeMap<String, String> {
        [
            (FORMAT, Some(LOG_FORMAT.to_string())),
            (EPOCH_OFFSET, Some(epoch_offset_ns.to_string())),
            ("program", Some(self.program.clone())),
            ("instance", Some(self.instance.to_string())),
            ("config", Some(self.config_toml.clone())),
            ("git_commit", self.git_commit.clone()),
            ("actor_sha256", self.actor_sha256.clone()),
            ("detector_sha256", self.detector_sha256.clone()),
            (
                "detector_threshold",
                self.detector_threshold.map(|threshold| threshold.to_string()),
            ),
            ("seed", self.seed.map(|seed| seed.to_string())),
        ]
        .into_iter()
        .filter_map(|(key, value)| Some((key.to_owned(), value?)))
        .collect()
    }

    /// Format version, flight information and epoch offset of a metadata record; `Err` names the first bad entry.
    pub(crate) fn from_metadata(map: &BTreeMap<String, String>) -> Result<(Self, u64), &'static str> {
        let text = |key: &'static str| map.get(key).ok_or(key);
        let info = Self {
            program: text("program")?.clone(),
            git_commit: map.get("git_commit").cloned(),
            instance: number(map, "instance")?.ok_or("instance")?,
            seed: number(map, "seed")?,
            actor_sha256: map.get("actor_sha256").cloned(),
            detector_sha256: map.get("detector_sha256").cloned(),
            detector_threshold: number(map, "detector_threshold")?,
            config_toml: text("config")?.clone(),
        };
        Ok((info, number(map, EPOCH_OFFSET)?.ok_or(EPOCH_OFFSET)?))
    }

    /// Format version of a metadata record, if it has one.
    pub(crate) fn format_version(map: &BTreeMap<String, String>) -> Option<u32> {
        number(map, FORMAT).ok().flatten()
    }
}

fn number<T: std::str::FromStr>(map: &BTreeMap<String, String>, key: &'static str) -> Result<Option<T>, &'static str> {
    map.get(key).map(|text| text.parse().map_err(|_| key)).transpose()
}
