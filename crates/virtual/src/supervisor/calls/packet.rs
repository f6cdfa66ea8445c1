//! Sockets: those on virtual interfaces are served here; those to the outside are passed to the
//! kernel.

use std::os::fd::AsFd;

use isocat_wire::time::{Nanos, Time};

use super::{Answer, Errno, Outcome, done, error};
use crate::kernel::{Kind, ObjectId, PacketSocket, Protocol, Readiness, TaskId};
use crate::supervisor::Supervisor;
use crate::sys;

/// `AF_XDP`, which Debian's C libraries do not define.
const AF_XDP: i32 = 44;
/// The number of the first virtual interface.
pub(super) const FIRST_INTERFACE: i32 = 7_000;
/// The longest frame without its check sequence, with a VLAN tag.
const MOST: usize = 1_518;
const HEADER: usize = 14;
/// The UDP port of EtherCAT: such frames would go to a real network.
const ETHERCAT_PORT: u16 = 0x88A4;
const DONT_WAIT: i32 = libc::MSG_DONTWAIT;

/// The addresses of the parts of a message in the program's memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Message {
    pub name: (u64, u32),
    pub parts: Vec<(u64, usize)>,
    control: (u64, usize),
    /// Address of its `msghdr`, if it has one.
    pub header: Option<u64>,
    /// Address of the length of the name, for `recvfrom`.
    pub name_length: u64,
    pub flags: i32,
}

impl Supervisor<'_> {
    pub(super) fn socket_call(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        match number {
            libc::SYS_socket => return self.socket(task, a),
            libc::SYS_socketpair => return self.socket_pair(task, a),
            libc::SYS_ioctl => return self.control(task, a),
            _ => {}
        }
        let Some(id) = self.object(task, a[0]) else { return self.pass_or_outside(task, a[0]) };
        match self.objects.get(id) {
            Some(Kind::Packet(_)) => self.packet_call(task, id, number, a, first),
            Some(Kind::Pipe(_)) if self.netlinks.contains_key(&id) => {
                self.netlink_call(task, id, number, a)
            }
            Some(Kind::Pipe(_)) => self.pair_call(task, id, number, a, first),
            Some(Kind::Outside(_)) => self.outside_call(task, id, number, a),
            _ => error(libc::ENOTSOCK),
        }
    }

    fn socket(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let (family, kind, protocol) = (a[0] as i32, a[1] as i32, a[2] as i32);
        let close_on_exec = kind & libc::SOCK_CLOEXEC != 0;
        let nonblocking = kind & libc::SOCK_NONBLOCK != 0;
        let kind = kind & !(libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK);
        match family {
            libc::AF_PACKET => {
                let protocol = wanted((protocol as u16).swap_bytes());
                let socket = PacketSocket::new(protocol, kind == libc::SOCK_DGRAM);
                let object = self.objects.add(Kind::Packet(socket), nonblocking);
                self.install(task, object, close_on_exec)
            }
            AF_XDP => self.refuse("socket(AF_XDP)", libc::EAFNOSUPPORT),
            libc::AF_INET | libc::AF_INET6 if kind == libc::SOCK_RAW => {
                self.refuse("a raw IP socket", libc::EPERM)
            }
            libc::AF_NETLINK => self.netlink_socket(task, protocol, nonblocking, close_on_exec),
            libc::AF_INET | libc::AF_INET6 | libc::AF_UNIX => {
                let flags = if nonblocking { libc::SOCK_NONBLOCK } else { 0 };
                let ours = sys::socket(family, kind | flags, protocol)?;
                self.install_outside(task, ours, nonblocking, close_on_exec)
            }
            other => self.refuse(&format!("socket of family {other}"), libc::EAFNOSUPPORT),
        }
    }

    /// Installs an outside descriptor in the program and keeps a copy here.
    pub(super) fn install_outside(
        &mut self,
        task: TaskId,
        ours: std::os::fd::OwnedFd,
        nonblocking: bool,
        close_on_exec: bool,
    ) -> Answer {
        let call = self.thread(task).call.id;
        let number = self.listener().add_descriptor(call, ours.as_fd(), None, close_on_exec)?;
        let object = self.objects.add(Kind::Outside(Readiness::NONE), nonblocking);
        self.outside.insert(object, ours);
        let descriptor = crate::supervisor::program::Descriptor { object, close_on_exec };
        self.process(task).descriptors.insert(number, descriptor);
        done(number.into())
    }

    fn socket_pair(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let kind = a[1] as i32;
        if a[0] as i32 != libc::AF_UNIX {
            return error(libc::EOPNOTSUPP);
        }
        let datagrams = kind & 0xF != libc::SOCK_STREAM;
        let (one, other) = self.objects.add_pair(datagrams, kind & libc::SOCK_NONBLOCK != 0);
        self.install_two(task, [one, other], kind & libc::SOCK_CLOEXEC != 0, a[3])
    }

    fn packet_call(
        &mut self,
        task: TaskId,
        id: ObjectId,
        number: i64,
        a: [u64; 6],
        first: bool,
    ) -> Answer {
        match number {
            libc::SYS_bind => self.bind(task, id, a),
            libc::SYS_setsockopt => self.set_option(task, id, a),
            libc::SYS_getsockopt => self.get_option(task, id, a),
            libc::SYS_getsockname => {
                let Some(Kind::Packet(socket)) = self.objects.get(id) else {
                    return error(libc::EBADF);
                };
                let (interface, protocol) = (socket.interface, socket.protocol);
                let address = self.address(interface, protocol, self.mac(interface.unwrap_or(0)));
                self.write_address(task, a[1], a[2], &address)?;
                done(0)
            }
            libc::SYS_getpeername
            | libc::SYS_connect
            | libc::SYS_listen
            | libc::SYS_accept
            | libc::SYS_accept4 => error(libc::EOPNOTSUPP),
            libc::SYS_shutdown => error(libc::EOPNOTSUPP),
            libc::SYS_sendmmsg | libc::SYS_recvmmsg => {
                self.refuse("sendmmsg/recvmmsg on a packet socket", libc::ENOSYS)
            }
            libc::SYS_sendto | libc::SYS_sendmsg => {
                let message = self.message(task, number, a)?;
                self.send_packet(task, id, &message)
            }
            libc::SYS_recvfrom | libc::SYS_recvmsg => {
                let message = self.message(task, number, a)?;
                self.receive_packet(task, id, &message, first)
            }
            _ => error(libc::EOPNOTSUPP),
        }
    }

    fn bind(&mut self, task: TaskId, id: ObjectId, a: [u64; 6]) -> Answer {
        let bytes = self.read_bytes(task, a[1], (a[2] as usize).min(20))?;
        if bytes.len() < 8 {
            return error(libc::EINVAL);
        }
        let protocol = u16::from_be_bytes([bytes[2], bytes[3]]);
        let index = i32::from_ne_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
        let interface = match index {
            0 => None,
            index => Some(self.interface_of(index)?),
        };
        let Some(Kind::Packet(socket)) = self.objects.get_mut(id) else {
            return error(libc::EBADF);
        };
        socket.interface = interface;
        if protocol != 0 {
            socket.protocol = wanted(protocol);
        }
        socket.clear();
        done(0)
    }

    /// The index of an interface with this number.
    pub(super) fn interface_of(&self, index: i32) -> Result<usize, Errno> {
        let place = usize::try_from(index - FIRST_INTERFACE).ok();
        place.filter(|place| *place < self.options.interfaces.len()).ok_or(Errno(libc::ENODEV))
    }

    pub(super) fn mac(&self, interface: usize) -> [u8; 6] {
        [0x02, 0, 0, 0, 0, 1 + interface as u8]
    }

    /// Builds a `sockaddr_ll`.
    fn address(&self, interface: Option<usize>, protocol: Protocol, mac: [u8; 6]) -> Vec<u8> {
        let mut address = vec![0; 20];
        address[0..2].copy_from_slice(&(libc::AF_PACKET as u16).to_ne_bytes());
        let protocol = match protocol {
            Protocol::None => 0,
            Protocol::All => libc::ETH_P_ALL as u16,
            Protocol::Type(wanted) => wanted,
        };
        address[2..4].copy_from_slice(&protocol.to_be_bytes());
        let index = interface.map_or(0, |place| FIRST_INTERFACE + place as i32);
        address[4..8].copy_from_slice(&index.to_ne_bytes());
        address[8..10].copy_from_slice(&1u16.to_ne_bytes());
        address[11] = 6;
        address[12..18].copy_from_slice(&mac);
        address
    }

    pub(super) fn write_address(
        &mut self,
        task: TaskId,
        at: u64,
        length_at: u64,
        address: &[u8],
    ) -> Result<(), Errno> {
        if at != 0 && length_at != 0 {
            let room = self.read_u32(task, length_at)? as usize;
            self.write(task, at, &address[..address.len().min(room)])?;
            self.write_u32(task, length_at, address.len() as u32)?;
        }
        Ok(())
    }

    pub(super) fn message(
        &mut self,
        task: TaskId,
        number: i64,
        a: [u64; 6],
    ) -> Result<Message, Errno> {
        if matches!(number, libc::SYS_sendto | libc::SYS_recvfrom) {
            let sends = number == libc::SYS_sendto;
            return Ok(Message {
                name: (a[4], if sends { a[5] as u32 } else { 0 }),
                name_length: if sends { 0 } else { a[5] },
                parts: vec![(a[1], a[2] as usize)],
                flags: a[3] as i32,
                ..Message::default()
            });
        }
        let [name, length, parts, count, control, room, _] = self.read_words(task, a[1])?;
        Ok(Message {
            name: (name, length as u32),
            parts: self.parts(task, parts, count)?,
            control: (control, room as usize),
            header: Some(a[1]),
            name_length: 0,
            flags: a[2] as i32,
        })
    }

    /// Reads the addresses and lengths of an `iovec`.
    pub(super) fn parts(
        &mut self,
        task: TaskId,
        at: u64,
        count: u64,
    ) -> Result<Vec<(u64, usize)>, Errno> {
        if count > 1024 {
            return Err(Errno(libc::EINVAL));
        }
        let bytes = self.read_bytes(task, at, 16 * count as usize)?;
        let word = |bytes: &[u8]| bytes.first_chunk().map_or(0, |word| u64::from_ne_bytes(*word));
        let parts = bytes.chunks_exact(16);
        Ok(parts.map(|part| (word(&part[..8]), word(&part[8..]) as usize)).collect())
    }

    fn send_packet(&mut self, task: TaskId, id: ObjectId, message: &Message) -> Answer {
        let Some(Kind::Packet(socket)) = self.objects.get(id) else { return error(libc::EBADF) };
        let (mut interface, cooked, protocol) = (socket.interface, socket.cooked, socket.protocol);
        let length: usize = message.parts.iter().map(|(_, len)| *len).sum();
        if length > MOST {
            return error(libc::EMSGSIZE);
        }
        let mut address = [0; 20];
        if message.name.0 != 0 && message.name.1 >= 12 {
            let length = (message.name.1 as usize).min(20);
            self.read(task, message.name.0, &mut address[..length])?;
            let index = i32::from_ne_bytes([address[4], address[5], address[6], address[7]]);
            interface = Some(self.interface_of(index)?);
        }
        let Some(interface) = interface else { return error(libc::ENXIO) };
        let mut frame = Vec::with_capacity(MOST);
        if cooked {
            let named = u16::from_be_bytes([address[2], address[3]]);
            let of_socket = if let Protocol::Type(wanted) = protocol { wanted } else { 0 };
            frame.extend_from_slice(&address[12..18]);
            frame.extend_from_slice(&self.mac(interface));
            frame.extend(if named == 0 { of_socket } else { named }.to_be_bytes());
        }
        for (at, len) in &message.parts {
            let part = self.read_bytes(task, *at, *len)?;
            frame.extend_from_slice(&part);
        }
        if frame.len() < HEADER {
            return error(libc::EINVAL);
        }
        if let Some(Kind::Packet(socket)) = self.objects.get(id)
            && let Some(has_untaken) = socket.has_untaken(&frame)
        {
            self.wire.about_to_send(has_untaken);
        }
        self.send_frame(interface, &frame);
        done(length as i64)
    }

    /// Sends a frame.
    fn send_frame(&mut self, interface: usize, frame: &[u8]) {
        let (cost, late) = (self.host.costs.send - self.host.costs.call, self.host.holds_up());
        self.scheduler.spend(cost.max(Nanos::ZERO));
        // The wire carries one frame after the other.
        let at = (self.now() + late).max(self.last_sent);
        self.last_sent = at;
        self.figures.sent += 1;
        let mut answers = Vec::new();
        self.wire.send(interface, at, frame, &mut answers);
        for mut answer in answers {
            // A frame does not overtake another one.
            let brought = answer.at + self.host.brings_up();
            answer.at = brought.max(self.last_back);
            self.last_back = answer.at;
            self.flying.push(answer);
        }
        self.suffer();
        // Sockets for all frames would also receive sent frames; that is not modelled, since
        // MainDevices do not ask for it.
    }

    pub(super) fn write_packet(
        &mut self,
        task: TaskId,
        id: ObjectId,
        parts: Vec<(u64, usize)>,
    ) -> Answer {
        self.send_packet(task, id, &Message { parts, ..Message::default() })
    }

    pub(super) fn read_packet(
        &mut self,
        task: TaskId,
        id: ObjectId,
        parts: Vec<(u64, usize)>,
        first: bool,
    ) -> Answer {
        self.receive_packet(task, id, &Message { parts, ..Message::default() }, first)
    }

    fn receive_packet(
        &mut self,
        task: TaskId,
        id: ObjectId,
        message: &Message,
        first: bool,
    ) -> Answer {
        if first {
            let cost = self.host.costs.receive - self.host.costs.call;
            self.scheduler.spend(cost.max(Nanos::ZERO));
            // Frames that arrived during the call are now in the socket.
            self.fire();
        }
        let nonblocking = self.objects.is_nonblocking(id);
        let Some(Kind::Packet(socket)) = self.objects.get_mut(id) else {
            return error(libc::EBADF);
        };
        let (patience, cooked, stamps) = (socket.patience, socket.cooked, socket.stamps);
        let frame = match message.flags & libc::MSG_PEEK {
            0 => socket.take(),
            _ => socket.peek().cloned(),
        };
        let Some(frame) = frame else {
            if first {
                let until = patience.map_or(Time::NEVER, |patience| self.now() + patience);
                self.thread(task).until = until;
            }
            let until = self.thread(task).until;
            let waits = message.flags & DONT_WAIT == 0 && !nonblocking && self.now() < until;
            return if waits { self.wait_for(task, until, &[id]) } else { error(libc::EAGAIN) };
        };
        let bytes = if cooked { &frame.bytes[HEADER..] } else { &frame.bytes[..] };
        let mut taken = 0;
        for (at, len) in &message.parts {
            let part = (*len).min(bytes.len() - taken);
            self.write(task, *at, &bytes[taken..taken + part])?;
            taken += part;
        }
        let ether_type = Protocol::Type(u16::from_be_bytes([frame.bytes[12], frame.bytes[13]]));
        let source = frame.bytes[6..12].first_chunk().copied().unwrap_or_default();
        let address = self.address(Some(frame.interface), ether_type, source);
        self.write_address(task, message.name.0, message.name_length, &address)?;
        if let Some(header) = message.header {
            let room = (message.name.1 as usize).min(address.len());
            if message.name.0 != 0 {
                self.write(task, message.name.0, &address[..room])?;
                self.write_u32(task, header + 8, address.len() as u32)?;
            }
            let stamp = frame.at.count() + self.epoch;
            let used = self.write_stamp(task, message.control, stamps, stamp)?;
            self.write_words(task, header + 40, &[used as u64])?;
            let truncated = if taken < bytes.len() { libc::MSG_TRUNC } else { 0 };
            self.write_u32(task, header + 48, truncated as u32)?;
        }
        let whole = message.flags & libc::MSG_TRUNC != 0;
        done(if whole { bytes.len() } else { taken } as i64)
    }

    /// Writes the stamp of a frame's arrival in the requested form. Returns the number of bytes
    /// used.
    fn write_stamp(
        &mut self,
        task: TaskId,
        (at, room): (u64, usize),
        form: Option<i32>,
        ns: u64,
    ) -> Result<usize, Errno> {
        let (seconds, nanos) = (ns / 1_000_000_000, ns % 1_000_000_000);
        let words: &[u64] = match form {
            None => return Ok(0),
            Some(libc::SO_TIMESTAMP) => &[seconds, nanos / 1_000],
            Some(libc::SO_TIMESTAMPNS) => &[seconds, nanos],
            // Software stamp, nothing, hardware stamp: there is no hardware that could stamp.
            Some(_) => &[seconds, nanos, 0, 0, 0, 0],
        };
        let used = 16 + 8 * words.len();
        if at == 0 || room < used {
            return Ok(0);
        }
        let kind = form.unwrap_or_default() as u64;
        self.write_words(task, at, &[used as u64, kind << 32 | libc::SOL_SOCKET as u64])?;
        self.write_words(task, at + 16, words)?;
        Ok(used)
    }

    /// A call on an outside socket.
    fn outside_call(&mut self, task: TaskId, id: ObjectId, number: i64, a: [u64; 6]) -> Answer {
        if matches!(number, libc::SYS_sendto | libc::SYS_connect) {
            let (at, length) = if number == libc::SYS_sendto { (a[4], a[5]) } else { (a[1], a[2]) };
            if at != 0 && length >= 4 {
                let address = self.read_bytes(task, at, 4)?;
                let family = i32::from(u16::from_ne_bytes([address[0], address[1]]));
                let port = u16::from_be_bytes([address[2], address[3]]);
                if [libc::AF_INET, libc::AF_INET6].contains(&family) && port == ETHERCAT_PORT {
                    return self.refuse("EtherCAT over UDP", libc::EPERM);
                }
            }
        }
        match number {
            libc::SYS_accept | libc::SYS_accept4 => {
                // The new socket is not tracked: waits on it are refused by name.
                Ok(Outcome::Outside)
            }
            _ if self.objects.is_nonblocking(id) => Ok(Outcome::Pass),
            libc::SYS_recvfrom | libc::SYS_recvmsg | libc::SYS_recvmmsg | libc::SYS_connect => {
                Ok(Outcome::Outside)
            }
            _ => Ok(Outcome::Pass),
        }
    }
}

fn wanted(protocol: u16) -> Protocol {
    match protocol {
        0 => Protocol::None,
        protocol if i32::from(protocol) == libc::ETH_P_ALL => Protocol::All,
        protocol => Protocol::Type(protocol),
    }
}
