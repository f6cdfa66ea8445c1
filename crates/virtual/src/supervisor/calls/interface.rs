//! Options of packet sockets, and requests about interfaces.

use isocat_wire::time::Nanos;

use super::packet::FIRST_INTERFACE;
use super::{Answer, Outcome, done, error};
use crate::kernel::{Kind, ObjectId, TaskId};
use crate::supervisor::Supervisor;

impl Supervisor<'_> {
    pub(super) fn set_option(&mut self, task: TaskId, id: ObjectId, a: [u64; 6]) -> Answer {
        let (level, name) = (a[1] as i32, a[2] as i32);
        let mut value = [0; 16];
        let length = (a[4] as usize).min(16);
        self.read(task, a[3], &mut value[..length])?;
        let word =
            |at: usize| value[at..].first_chunk().map_or(0, |word| u64::from_ne_bytes(*word));
        let number = i32::from_ne_bytes([value[0], value[1], value[2], value[3]]);
        if (level, name) == (libc::SOL_SOCKET, libc::SO_BINDTODEVICE) {
            let text = String::from_utf8_lossy(&value[..length]);
            let name = text.trim_end_matches('\0');
            let place = self.options.interfaces.iter().position(|known| known == name);
            let Some(Kind::Packet(socket)) = self.objects.get_mut(id) else {
                return error(libc::EBADF);
            };
            socket.interface = place;
            return if place.is_some() { done(0) } else { error(libc::ENODEV) };
        }
        let Some(Kind::Packet(socket)) = self.objects.get_mut(id) else {
            return error(libc::EBADF);
        };
        match (level, name) {
            (libc::SOL_SOCKET, libc::SO_RCVTIMEO) => {
                let ns = word(0).saturating_mul(1_000_000_000).saturating_add(word(8) * 1_000);
                socket.patience = (ns > 0).then_some(Nanos(ns.min(i64::MAX as u64 / 2) as i64));
                done(0)
            }
            (
                libc::SOL_SOCKET,
                libc::SO_TIMESTAMP | libc::SO_TIMESTAMPNS | libc::SO_TIMESTAMPING,
            ) => {
                socket.stamps = (number != 0).then_some(name);
                done(0)
            }
            (libc::SOL_SOCKET, libc::SO_ATTACH_FILTER | libc::SO_ATTACH_BPF) => {
                self.note(
                    "a filter of a packet socket was not applied: all frames of its EtherType come",
                );
                done(0)
            }
            (libc::SOL_SOCKET, _) => done(0),
            // Rings in shared memory are refused: all stacks then fall back to send and receive.
            (
                libc::SOL_PACKET,
                libc::PACKET_RX_RING | libc::PACKET_TX_RING | libc::PACKET_VERSION,
            ) => self.refuse("PACKET_MMAP", libc::ENOPROTOOPT),
            (libc::SOL_PACKET, libc::PACKET_ADD_MEMBERSHIP | libc::PACKET_DROP_MEMBERSHIP) => {
                done(0)
            }
            // Quality of service, and ignoring outgoing frames, make no difference here.
            (libc::SOL_PACKET, 20 | 23) => done(0),
            (level, name) => self.refuse(
                &format!("option {name} of level {level} of a packet socket"),
                libc::ENOPROTOOPT,
            ),
        }
    }

    pub(super) fn get_option(&mut self, task: TaskId, id: ObjectId, a: [u64; 6]) -> Answer {
        let Some(Kind::Packet(socket)) = self.objects.get_mut(id) else {
            return error(libc::EBADF);
        };
        let kind = if socket.cooked { libc::SOCK_DGRAM } else { libc::SOCK_RAW };
        let value = match (a[1] as i32, a[2] as i32) {
            (libc::SOL_SOCKET, libc::SO_ERROR) => vec![0],
            (libc::SOL_SOCKET, libc::SO_TYPE) => vec![kind as u32],
            (libc::SOL_SOCKET, libc::SO_DOMAIN) => vec![libc::AF_PACKET as u32],
            (libc::SOL_SOCKET, libc::SO_RCVBUF | libc::SO_SNDBUF) => vec![212_992],
            (libc::SOL_PACKET, libc::PACKET_STATISTICS) => {
                vec![0, std::mem::take(&mut socket.dropped)]
            }
            _ => return error(libc::ENOPROTOOPT),
        };
        let bytes: Vec<u8> = value.iter().flat_map(|value| value.to_ne_bytes()).collect();
        self.write_address(task, a[3], a[4], &bytes)?;
        done(0)
    }

    pub(super) fn control(&mut self, task: TaskId, a: [u64; 6]) -> Answer {
        let object = self.object(task, a[0]);
        let request = a[1];
        if let Some(id) = object {
            match request {
                libc::FIONBIO => {
                    let on = self.read_u32(task, a[2])? != 0;
                    self.objects.set_nonblocking(id, on);
                    return Ok(Outcome::Pass);
                }
                libc::FIONREAD => return self.waiting_bytes(task, id, a[2]),
                _ => {}
            }
        }
        let is_packet = matches!(object.and_then(|id| self.objects.get(id)), Some(Kind::Packet(_)));
        // Requests about interfaces have these numbers.
        if !(0x8900..0x8A00).contains(&request) {
            return if is_packet { error(libc::ENOTTY) } else { Ok(Outcome::Pass) };
        }
        self.about_interface(task, is_packet, request, a[2])
    }

    fn about_interface(&mut self, task: TaskId, is_packet: bool, request: u64, at: u64) -> Answer {
        let mut about = self.read_bytes(task, at, 40)?;
        let end = about[..16].iter().position(|byte| *byte == 0).unwrap_or(16);
        let name = String::from_utf8_lossy(&about[..end]).into_owned();
        if request == libc::SIOCGIFNAME {
            let index = i32::from_ne_bytes([about[16], about[17], about[18], about[19]]);
            let Ok(place) = self.interface_of(index) else {
                return if is_packet { error(libc::ENODEV) } else { Ok(Outcome::Pass) };
            };
            let mut name = self.options.interfaces[place].clone().into_bytes();
            name.resize(16, 0);
            self.write(task, at, &name)?;
            return done(0);
        }
        let Some(place) = self.options.interfaces.iter().position(|known| *known == name) else {
            let only_asks = matches!(
                request,
                libc::SIOCGIFCONF
                    | libc::SIOCGIFINDEX
                    | libc::SIOCGIFFLAGS
                    | libc::SIOCGIFHWADDR
                    | libc::SIOCGIFMTU
                    | libc::SIOCGIFADDR
            );
            if is_packet || request == libc::SIOCGIFINDEX {
                self.note(format!(
                    "the program asked for interface {name}, at which there is no segment: the virtual one is {}",
                    self.options.interfaces.join(" and ")
                ));
            }
            // Sockets that cannot send to real interfaces may still query them.
            return if only_asks && !is_packet { Ok(Outcome::Pass) } else { error(libc::ENODEV) };
        };
        let up =
            (libc::IFF_UP | libc::IFF_RUNNING | libc::IFF_BROADCAST | libc::IFF_MULTICAST) as u16;
        match request {
            libc::SIOCGIFINDEX => {
                about[16..20].copy_from_slice(&(FIRST_INTERFACE + place as i32).to_ne_bytes());
            }
            libc::SIOCGIFFLAGS => about[16..18].copy_from_slice(&up.to_ne_bytes()),
            libc::SIOCGIFMTU => about[16..20].copy_from_slice(&1500i32.to_ne_bytes()),
            libc::SIOCGIFHWADDR => {
                about[16..18].copy_from_slice(&1u16.to_ne_bytes());
                about[18..24].copy_from_slice(&self.mac(place));
            }
            libc::SIOCSIFFLAGS | libc::SIOCSIFMTU => return done(0),
            libc::SIOCGIFADDR => return error(libc::EADDRNOTAVAIL),
            _ => return error(libc::EOPNOTSUPP),
        }
        self.write(task, at, &about)?;
        done(0)
    }
}
