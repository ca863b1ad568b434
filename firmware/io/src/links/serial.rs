//! MAVLink over a serial line; the device may disappear and return.

use super::packet_stream::PacketStream;
use super::{LinkAdmission, LinkStatistics, PeerRule, RETRY_NS, Wire};
use crate::gate::SigningGate;
use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, QueueSelector};
use std::ffi::CString;
use std::fs::File;
use vigil_mavlink::framing::StreamFramer;
use vigil_types::{Datagrams, Nanos};

/// One serial line: 8 data bits, no parity, one stop bit, no flow control.
pub struct SerialWire {
    device: CString,
    baud: u32,
    port: Option<File>,
    next_attempt_ns: Nanos,
    framer: StreamFramer,
    stream: PacketStream,
}

impl SerialWire {
    pub(crate) fn open(device: &str, baud: u32) -> std::io::Result<Self> {
        let device = CString::new(device)?;
        let port = open_port(&device, baud)?;
        let mut stream = PacketStream::new();
        stream.begin();
        Ok(Self {
            device,
            baud,
            port: Some(port),
            next_attempt_ns: 0,
            framer: StreamFramer::default(),
            stream,
        })
    }

    /// Opens the device again when it is time to try.
    fn reopen(&mut self, now_ns: Nanos) {
        if self.port.is_some() || now_ns < self.next_attempt_ns {
            return;
        }
        self.next_attempt_ns = now_ns + RETRY_NS;
        if let Ok(port) = open_port(&self.device, self.baud) {
            self.framer = StreamFramer::default();
            self.stream.begin();
            self.port = Some(port);
        }
    }

    /// The device is gone.
    fn close(&mut self) {
        if let Some(port) = self.port.take() {
            // So that closing does not wait for what can no longer be sent. A device that is gone refuses; it has nothing.
            let _ = rustix::termios::tcflush(&port, QueueSelector::IOFlush);
        }
    }
}

/// Opens and sets up a line without waiting for a carrier.
fn open_port(device: &CString, baud: u32) -> Result<File, Errno> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = open(device.as_c_str(), flags, Mode::empty())?;
    let mut settings = rustix::termios::tcgetattr(&port)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD | ControlModes::CS8;
    settings.control_modes &= !(ControlModes::CSTOPB | ControlModes::PARENB | ControlModes::CRTSCTS);
    settings.set_speed(baud)?;
    rustix::termios::tcsetattr(&port, OptionalActions::Now, &settings)?;
    // Two programs on one line would take each other's bytes.
    rustix::termios::ioctl_tiocexcl(&port)?;
    rustix::termios::tcflush(&port, QueueSelector::IFlush)?;
    Ok(File::from(port))
}

impl Wire for SerialWire {
    fn receive(&mut self, now_ns: Nanos, admission: &mut LinkAdmission<'_>, received: &mut Datagrams) {
        self.reopen(now_ns);
        let Some(port) = &mut self.port else { return };
        // Whoever holds the other end of a cable is not known: never this machine.
        let with = (PeerRule::Anyone, admission, false);
        if self.stream.receive(port, &mut self.framer, with, received).is_err() {
            self.close();
        }
    }

    fn send(&mut self, gate: &mut SigningGate, sent: &Datagrams) {
        let Some(port) = &mut self.port else {
            self.stream.discard(sent);
            return;
        };
        if self.stream.send(port, gate, sent).is_err() {
            self.close();
        }
    }

    fn statistics(&self) -> (LinkStatistics, bool) {
        (self.stream.statistics, true)
    }
}
