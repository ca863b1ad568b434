//! Packets of an Ouster sensor, turn by turn, as depth images.
//!
//! Packets are of the LEGACY format (Ouster, *Software User Manual*, "Lidar data packet format"), little-endian: of each column 16 bytes
//! of header (u64 stamp in nanoseconds, u16 column, u16 turn, u32 encoder), 12 bytes a beam (u32 of which the lower 20 bits are the
//! range in millimetres, 0 for no return; the rest is of the signal), and u32 of status, all ones where the column is good.

use super::{DeviceClock, Fault, OusterDevice};
use crate::{Mount, ProjectionError, Projector, Resolution, View};
use vigil_types::{DEPTH_PIXELS, Nanos};

const COLUMN_HEADER: usize = 16;
const BEAM_BYTES: usize = 12;
const COLUMN_STATUS: usize = 4;
const GOOD: u32 = 0xffff_ffff;
const RANGE_BITS: u32 = 0x000f_ffff;
/// Steps of the encoder in a turn.
const ENCODER_STEPS: u32 = 90_112;
/// What every beam measures where the view is looked for, millimetres.
const PROBE_MM: u32 = 10_000;
/// And the nearest thing of which no column in view may be left out: from a sensor beside the middle it is seen at other bearings.
const NEAR_MM: u32 = 1_000;

/// Why an adapter cannot be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// The beams' angles cannot be projected.
    #[error(transparent)]
    Projection(#[from] ProjectionError),
    /// Nothing of the sensor's view is in the image.
    #[error("mounted so, not one beam or pixel looks where the vehicle flies: see --mount")]
    LooksElsewhere,
    /// A turn begins in the middle of the view.
    #[error(
        "mounted so, the sensor begins its turns in the middle of the view, so that two halves of a picture would be a turn apart: turn it about its axis, its connector away from ahead"
    )]
    TurnBeginsInView,
}

/// Packets of one sensor become depth images. A turn of which a column in view is missing becomes none: what was not seen must not look
/// free.
pub struct OusterAdapter {
    /// The sensor.
    pub device: OusterDevice,
    mount: Mount,
    projector: Projector,
    /// The part of our image that it sees.
    pub view: Option<View>,
    /// Columns in view, from the first to the one after the last.
    needed: std::ops::Range<usize>,
    turn: Option<Turn>,
    /// Of the columns needed: ranges beam by beam, stamps, and whether they came.
    ranges_mm: Vec<u32>,
    stamps_ns: Vec<Option<Nanos>>,
    clock: DeviceClock,
}

#[derive(Clone, Copy)]
struct Turn {
    number: u16,
    done: bool,
    /// It was not seen from its start.
    partial: bool,
}

impl OusterAdapter {
    /// For a sensor that is mounted so.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn new(device: OusterDevice, mount: Mount) -> Result<Self, SetupError> {
        let (across, down) = device.resolution_deg();
        let mut projector = Projector::new(Resolution::of_degrees(across, down)?);
        let mut is_needed = vec![false; device.columns];
        let mut depth = Box::new([1.0; DEPTH_PIXELS]);
        // The image of the last range stays: the view.
        for range_mm in [NEAR_MM, PROBE_MM] {
            for (column, is_needed) in is_needed.iter_mut().enumerate() {
                let points = (0..device.beams()).filter_map(|beam| device.point_frd_m(column, beam, range_mm));
                *is_needed |= projector.add_points(&mount, points).used > 0;
            }
            projector.finish(&mut depth);
        }
        let first = is_needed.iter().position(|n| *n).ok_or(SetupError::LooksElsewhere)?;
        let count = is_needed.iter().filter(|n| **n).count();
        let needed = first..first + count;
        if is_needed.get(needed.clone()).is_none_or(|run| run.contains(&false)) {
            return Err(SetupError::TurnBeginsInView);
        }
        Ok(Self {
            view: View::of(&depth),
            ranges_mm: vec![0; count * device.beams()],
            stamps_ns: vec![None; count],
            device,
            mount,
            projector,
            needed,
            turn: None,
            clock: DeviceClock::default(),
        })
    }

    fn column_bytes(&self) -> usize {
        COLUMN_HEADER + BEAM_BYTES * self.device.beams() + COLUMN_STATUS
    }

    /// Bytes of a packet.
    pub fn packet_bytes(&self) -> usize {
        self.column_bytes() * self.device.columns_per_packet
    }

    /// Takes a packet that arrived at `arrived_ns`. With the last column in view it writes the image and returns the time, on
    /// CLOCK_MONOTONIC, at which the sensor looked at the view's middle.
    ///
    /// # Errors
    /// Why there is no image; the next packet is taken as ever.
    pub fn packet(
        &mut self,
        bytes: &[u8],
        arrived_ns: Nanos,
        depth: &mut [f32; DEPTH_PIXELS],
    ) -> Result<Option<Nanos>, Fault> {
        let expected = self.packet_bytes();
        if bytes.len() != expected {
            return Err(Fault::PacketLength {
                got: bytes.len(),
                expected,
            });
        }
        let (number, first_column, newest_ns) = self.check(bytes).ok_or(Fault::PacketContent)?;
        let lost = self.begin(number, first_column)?;
        for block in bytes.chunks_exact(self.column_bytes()).filter_map(Block::of) {
            self.store(&block);
        }
        if let Some(fault) = lost {
            return Err(fault);
        }
        let is_whole = self.stamps_ns.iter().all(Option::is_some);
        let Some(turn) = self.turn.as_mut().filter(|turn| !turn.done && is_whole) else {
            return Ok(None);
        };
        turn.done = true;
        let middle_ns = self
            .stamps_ns
            .get(self.stamps_ns.len() / 2)
            .copied()
            .flatten()
            .unwrap_or(newest_ns);
        let stamp_ns = self.clock.monotonic_ns(middle_ns, newest_ns, arrived_ns)?;
        for (column, ranges_mm) in (self.needed.clone()).zip(self.ranges_mm.chunks_exact(self.device.beams())) {
            let returned = ranges_mm.iter().enumerate().filter(|(_, mm)| **mm > 0);
            let points = returned.filter_map(|(beam, mm)| self.device.point_frd_m(column, beam, *mm));
            self.projector.add_points(&self.mount, points);
        }
        match self.projector.finish(depth) {
            0 => Err(Fault::EmptyImage),
            _ => Ok(Some(stamp_ns)),
        }
    }

    /// Turn, first column and newest stamp of a packet whose columns follow each other; `None` where they cannot be this device's.
    fn check(&self, bytes: &[u8]) -> Option<(u16, usize, Nanos)> {
        let mut blocks = bytes.chunks_exact(self.column_bytes()).filter_map(Block::of);
        let first = blocks.next()?;
        let (mut column, mut newest_ns) = (first.column, first.stamp_ns);
        let is_sound = |block: &Block<'_>| block.column < self.device.columns && block.encoder < ENCODER_STEPS;
        if !is_sound(&first) {
            return None;
        }
        for block in blocks {
            column += 1;
            let follows = block.turn == first.turn && block.column == column && block.stamp_ns >= newest_ns;
            if !follows || !is_sound(&block) {
                return None;
            }
            newest_ns = block.stamp_ns;
        }
        Some((first.turn, first.column, newest_ns))
    }

    /// Goes on to another turn if a packet is of one; what the turn before lacked.
    fn begin(&mut self, number: u16, first_column: usize) -> Result<Option<Fault>, Fault> {
        let before = self.turn;
        match before {
            Some(turn) if turn.number == number => return Ok(None),
            // Numbers wrap around: the nearer way counts. A sensor that starts anew begins anywhere, and is older for no more than a turn.
            Some(turn) if (1..8).contains(&turn.number.wrapping_sub(number)) => return Err(Fault::LatePacket),
            _ => {}
        }
        let missing = self.stamps_ns.iter().filter(|stamp| stamp.is_none()).count();
        let skipped = before.map_or(0, |turn| number.wrapping_sub(turn.number).saturating_sub(1));
        self.stamps_ns.fill(None);
        self.turn = Some(Turn {
            number,
            done: false,
            partial: before.is_none() && first_column > self.needed.start,
        });
        let needed = self.needed.len();
        Ok(match before {
            Some(turn) if !turn.done && !turn.partial => Some(Fault::LostColumns { missing, needed }),
            Some(_) if (1..1000).contains(&skipped) => Some(Fault::LostColumns {
                missing: needed,
                needed,
            }),
            _ => None,
        })
    }

    fn store(&mut self, block: &Block<'_>) {
        let place = block.column.checked_sub(self.needed.start).filter(|_| block.is_good);
        let Some((place, stamp)) = place.and_then(|i| Some((i, self.stamps_ns.get_mut(i)?))) else {
            return;
        };
        *stamp = Some(block.stamp_ns);
        let beams = self.device.beams();
        let slots = self.ranges_mm.iter_mut().skip(place * beams).take(beams);
        for (slot, [a, b, c, d, ..]) in slots.zip(block.beams.as_chunks::<BEAM_BYTES>().0) {
            *slot = u32::from_le_bytes([*a, *b, *c, *d]) & RANGE_BITS;
        }
    }
}

/// A column of a packet.
struct Block<'a> {
    stamp_ns: Nanos,
    column: usize,
    turn: u16,
    encoder: u32,
    beams: &'a [u8],
    is_good: bool,
}

impl<'a> Block<'a> {
    fn of(bytes: &'a [u8]) -> Option<Self> {
        let (before, status) = bytes.split_last_chunk::<COLUMN_STATUS>()?;
        Some(Self {
            stamp_ns: u64::from_le_bytes(at(bytes, 0)?),
            column: u16::from_le_bytes(at(bytes, 8)?).into(),
            turn: u16::from_le_bytes(at(bytes, 10)?),
            encoder: u32::from_le_bytes(at(bytes, 12)?),
            beams: before.get(COLUMN_HEADER..)?,
            is_good: u32::from_le_bytes(*status) == GOOD,
        })
    }
}

fn at<const N: usize>(bytes: &[u8], from: usize) -> Option<[u8; N]> {
    bytes.get(from..)?.first_chunk().copied()
}
