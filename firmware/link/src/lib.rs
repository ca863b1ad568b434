//! Sans-IO MAVLink: framing and the guidance computer's side of the protocol.
