//! The configuration reference in the documentation is what the program takes.

use vigil_firmware::FirmwareConfig;

const DOCS: &str = include_str!("../../docs/firmware.md");

fn reference() -> String {
    let (_, rest) = DOCS.split_once("```toml\n").unwrap();
    let (block, _) = rest.split_once("```").unwrap();
    block.to_owned()
}

#[test]
fn the_reference_is_the_default() {
    assert_eq!(FirmwareConfig::from_toml(&reference()), Ok(FirmwareConfig::default()));
}

#[test]
fn every_key_of_the_reference_is_known_and_every_key_is_in_the_reference() {
    // With the keys that have no default switched on.
    let full = reference().replace("\n# ", "\n");
    let config = FirmwareConfig::from_toml(&full).unwrap();
    let written = config.to_toml();
    let keys = |text: &str| -> Vec<String> {
        let mut keys: Vec<String> = text
            .lines()
            .filter_map(|line| Some(line.split_once([' ', ']'])?.0.to_owned()))
            .collect();
        keys.sort();
        keys
    };
    assert_eq!(keys(&written), keys(&full));
}
