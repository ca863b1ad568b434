//! Status texts to people. <https://mavlink.io/en/messages/common.html#STATUSTEXT>

use crate::core::Core;
use vigil_link::MavMessage;
use vigil_link::common::{MavSeverity, STATUSTEXT_DATA};

const CHUNK: usize = 50;

impl Core {
    /// Sends a text on all links; longer than 50 bytes in chunks of one id.
    pub fn text(&mut self, severity: MavSeverity, text: &str) {
        self.texts += 1;
        text.clone_into(&mut self.last_text);
        // An id of 0 means that the text is not continued.
        let id = if text.len() > CHUNK {
            (self.texts % u64::from(u16::MAX)) as u16 + 1
        } else {
            0
        };
        for (chunk_seq, chunk) in text.as_bytes().chunks(CHUNK).enumerate() {
            let mut padded = [0; CHUNK];
            padded[..chunk.len()].copy_from_slice(chunk);
            let message = MavMessage::STATUSTEXT(STATUSTEXT_DATA {
                severity,
                text: padded.into(),
                id,
                chunk_seq: chunk_seq as u8,
            });
            self.outbox.send_all(&message);
        }
    }
}
