//! The `.tlog` beside the log: what MAVLink ground tools read. Per packet 8 bytes of big-endian microseconds since the
//! UNIX epoch, then the packet (<https://mavlink.io/en/file_formats/>, the layout that MAVProxy, QGroundControl and
//! pymavlink share).

use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use vigil_types::Datagrams;

/// The length of a packet that begins so, if one does.
fn packet_len([magic, length, flags]: [u8; 3]) -> Option<usize> {
    match magic {
        // v2: 10 header bytes, payload, checksum, and 13 bytes of signature if the first flag says so.
        0xFD => Some(12 + usize::from(length) + if flags & 1 == 1 { 13 } else { 0 }),
        // v1: 6 header bytes, payload, checksum.
        0xFE => Some(8 + usize::from(length)),
        _ => None,
    }
}

/// Cuts a datagram into its MAVLink packets by their length fields. Bytes that are no packet are left out, because a
/// tlog has no place for them; the MCAP file holds the whole datagram. Checksums are not checked: what was on the wire
/// is kept.
fn packets(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        loop {
            let len = bytes.first_chunk().copied().and_then(packet_len);
            match len.and_then(|len| bytes.split_at_checked(len)) {
                Some((packet, rest)) => {
                    bytes = rest;
                    return Some(packet);
                }
                None => bytes = bytes.split_first()?.1,
            }
        }
    })
}

/// Appends every packet of `datagrams` to a tlog; `at_ns` counts from the UNIX epoch.
pub(crate) fn write(tlog: &mut impl Write, at_ns: u64, datagrams: &Datagrams) -> io::Result<()> {
    let stamp = (at_ns / 1000).to_be_bytes();
    for packet in datagrams.iter().flat_map(|(_, bytes)| packets(bytes)) {
        tlog.write_all(&stamp)?;
        tlog.write_all(packet)?;
    }
    Ok(())
}

/// The newest stamp of a tlog as nanoseconds since the UNIX epoch, as far as the file is whole; `None` where there is none.
pub(crate) fn last_stamp_ns(path: &Path) -> Option<u64> {
    let mut file = BufReader::new(vigil_types::files::open(path).ok()?);
    let mut last = None;
    loop {
        let mut entry = [0; 8 + 3];
        if file.read_exact(&mut entry).is_err() {
            return last;
        }
        let [stamp @ .., magic, length, flags] = entry;
        let Some(len) = packet_len([magic, length, flags]) else {
            return last;
        };
        if file.seek_relative(len as i64 - 3).is_err() {
            return last;
        }
        last = Some(u64::from_be_bytes(stamp).saturating_mul(1000));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn v1(length: u8) -> Vec<u8> {
        let mut packet = vec![0xFE, length];
        packet.resize(8 + usize::from(length), 1);
        packet
    }

    fn v2(length: u8, signed: bool) -> Vec<u8> {
        let mut packet = vec![0xFD, length, signed.into()];
        packet.resize(12 + usize::from(length) + if signed { 13 } else { 0 }, 2);
        packet
    }

    #[test]
    fn a_datagram_of_several_packets_becomes_one_entry_each() {
        let all = [v2(9, false), v1(3), v2(0, true), v2(255, false)];
        assert!(packets(&all.concat()).eq(all.iter().map(Vec::as_slice)));
    }

    #[test]
    fn garbage_and_cut_packets_are_left_out_and_what_follows_is_found() {
        let good = v2(4, false);
        let bytes = [&[0x00, 0xFD][..], &good, &[0x55], &v1(2), &good[..7]].concat();
        assert!(packets(&bytes).eq([&good[..], &v1(2)]));
        for cut in 0..good.len() {
            assert_eq!(packets(&good[..cut]).count(), 0);
        }
    }

    #[test]
    fn stamps_are_big_endian_microseconds() {
        let mut datagrams = Datagrams::default();
        assert!(datagrams.push(0, &v1(0)));
        let mut tlog = Vec::new();
        write(&mut tlog, 0x0102_0304_0506 * 1000 + 999, &datagrams).unwrap();
        assert_eq!(&tlog[..9], &[0, 0, 1, 2, 3, 4, 5, 6, 0xFE]);
    }
}
