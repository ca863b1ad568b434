//! Texts for people: STATUSTEXT in as many chunks as they need.
//! <https://mavlink.io/en/messages/common.html#STATUSTEXT>

use crate::framing::filled;
use crate::message;
use core::fmt::{Arguments, Write};
pub(crate) use mavlink::dialects::common::MavSeverity::{
    MAV_SEVERITY_CRITICAL as CRITICAL, MAV_SEVERITY_ERROR as ERROR, MAV_SEVERITY_INFO as INFO,
    MAV_SEVERITY_NOTICE as NOTICE, MAV_SEVERITY_WARNING as WARNING,
};
use mavlink::dialects::common::{MavMessage, MavSeverity};

/// Bytes of a chunk.
const CHUNK: usize = 50;
/// Longest text; what is beyond is cut.
const LONGEST: usize = 200;

/// A text and how severe it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatusText {
    severity: MavSeverity,
    bytes: [u8; LONGEST],
    len: usize,
}

impl StatusText {
    /// Of any length; what is beyond 200 bytes is cut.
    pub fn new(severity: MavSeverity, text: Arguments<'_>) -> Self {
        let mut new = Self {
            severity,
            bytes: [0; LONGEST],
            len: 0,
        };
        // Cannot fail: writing never does.
        let _ = new.write_fmt(text);
        new
    }

    /// How severe it is.
    pub fn severity(&self) -> MavSeverity {
        self.severity
    }

    /// The whole text.
    pub fn text(&self) -> &str {
        // All texts are ASCII, so that a cut never splits a character.
        core::str::from_utf8(self.bytes()).unwrap_or_default()
    }

    fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }

    /// The messages of the text. A text of one message has the id 0; several share `id`, and the first zero byte ends the
    /// text, so one that fills its last chunk is followed by an empty one.
    pub fn messages(&self, id: u16) -> impl Iterator<Item = MavMessage> {
        let is_one = self.len <= CHUNK;
        let count = if is_one { 1 } else { self.len / CHUNK + 1 };
        (0..count).map(move |number| {
            let text: [u8; CHUNK] = filled(self.bytes().iter().skip(number * CHUNK).copied());
            let (severity, id) = (self.severity, if is_one { 0 } else { id });
            // At most LONGEST / CHUNK.
            message!(STATUSTEXT, severity, text = text.into(), id, chunk_seq = number as u8)
        })
    }
}

impl Write for StatusText {
    fn write_str(&mut self, s: &str) -> core::fmt::Result {
        for (slot, byte) in self.bytes.iter_mut().skip(self.len).zip(s.bytes()) {
            *slot = byte;
            self.len += 1;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Texts, ids and numbers of the chunks.
    fn chunks(len: usize) -> std::vec::Vec<(std::string::String, u16, u8)> {
        let digits: std::string::String = ('0'..='9').cycle().take(len).collect();
        let text = StatusText::new(INFO, format_args!("{digits}"));
        assert_eq!(text.text().len(), len.min(LONGEST));
        text.messages(7)
            .map(|message| match message {
                MavMessage::STATUSTEXT(m) => (m.text.to_str().unwrap().into(), m.id, m.chunk_seq),
                other => panic!("{other:?}"),
            })
            .collect()
    }

    #[test]
    fn a_text_of_up_to_50_bytes_is_one_message_and_a_longer_one_as_many_as_it_needs() {
        for len in [0, 1, 50] {
            let one = chunks(len);
            assert_eq!((one.len(), one[0].0.len(), one[0].1, one[0].2), (1, len, 0, 0));
        }
        let two = chunks(51);
        assert_eq!((two[0].0.len(), two[0].1, two[0].2), (50, 7, 0));
        assert_eq!(two[1..], [("0".into(), 7, 1)]);
        let three = chunks(100);
        assert_eq!(
            three[2],
            (std::string::String::new(), 7, 2),
            "a zero byte ends the text"
        );
        let longest = chunks(1000);
        assert_eq!((longest.len(), longest[3].0.len(), longest[4].0.len()), (5, 50, 0));
    }
}
