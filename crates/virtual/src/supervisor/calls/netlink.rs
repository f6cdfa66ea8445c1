//! Requests about interfaces through a netlink socket: the answers contain only the virtual
//! interfaces.

use super::packet::FIRST_INTERFACE;
use super::{Answer, Errno, done, error};
use crate::kernel::{Kind, ObjectId, TaskId};
use crate::supervisor::Supervisor;

const ERROR: u16 = 2;
const DONE: u16 = 3;
const NEW_LINK: u16 = 16;
const GET_LINK: u16 = 18;
const GET_ADDRESS: u16 = 22;
/// The message is one of several.
const MULTI: u16 = 2;
/// The request asks for all entries of a kind.
const DUMP: u16 = 0x300;
const HEADER: usize = 16;
/// `ifinfomsg`.
const ABOUT: usize = 16;
const ADDRESS: u16 = 1;
const BROADCAST: u16 = 2;
const NAME: u16 = 3;
const MTU: u16 = 4;
/// Longest request that is evaluated.
const LONGEST: usize = 4096;

impl Supervisor<'_> {
    /// Creates a socket whose answers are made here and wait in a pipe that the program reads.
    pub(super) fn netlink_socket(
        &mut self,
        task: TaskId,
        protocol: i32,
        nonblocking: bool,
        close_on_exec: bool,
    ) -> Answer {
        if protocol != libc::NETLINK_ROUTE {
            return self.refuse(&format!("netlink socket {protocol}"), libc::EPROTONOSUPPORT);
        }
        let (object, ours) = self.objects.add_pair(true, nonblocking);
        // Our end stays open as long as the program's.
        self.netlinks.insert(object, ours);
        self.install(task, object, close_on_exec)
    }

    pub(super) fn netlink_call(
        &mut self,
        task: TaskId,
        id: ObjectId,
        number: i64,
        a: [u64; 6],
    ) -> Answer {
        let port = self.number_of(task) as u32;
        match number {
            libc::SYS_bind | libc::SYS_setsockopt | libc::SYS_connect => done(0),
            libc::SYS_getsockopt => error(libc::ENOPROTOOPT),
            libc::SYS_getsockname => {
                self.write_address(task, a[1], a[2], &address(port))?;
                done(0)
            }
            libc::SYS_sendto | libc::SYS_sendmsg => {
                let message = self.message(task, number, a)?;
                let mut request = Vec::new();
                for (at, len) in &message.parts {
                    request.extend(self.read_bytes(task, *at, (*len).min(LONGEST))?);
                }
                self.answer_netlink(id, port, &request)?;
                done(request.len() as i64)
            }
            libc::SYS_recvfrom | libc::SYS_recvmsg => {
                let message = self.message(task, number, a)?;
                let from = address(0);
                self.write_address(task, message.name.0, message.name_length, &from)?;
                if let Some(header) = message.header {
                    let room = (message.name.1 as usize).min(from.len());
                    if message.name.0 != 0 {
                        self.write(task, message.name.0, &from[..room])?;
                        self.write_u32(task, header + 8, room as u32)?;
                    }
                    self.write_words(task, header + 40, &[0])?;
                    self.write_u32(task, header + 48, 0)?;
                }
                if message.flags & libc::MSG_PEEK != 0 {
                    return self.peek_netlink(task, id, &message.parts, message.flags);
                }
                let answer = self.read_pipe(task, id, &message.parts);
                let dont_wait = message.flags & libc::MSG_DONTWAIT != 0;
                match answer {
                    Ok(super::Outcome::Wait(..)) if dont_wait => error(libc::EAGAIN),
                    answer => answer,
                }
            }
            _ => error(libc::EOPNOTSUPP),
        }
    }

    /// The next answer, which is not removed.
    fn peek_netlink(
        &mut self,
        task: TaskId,
        id: ObjectId,
        parts: &[(u64, usize)],
        flags: i32,
    ) -> Answer {
        let Some(&Kind::Pipe(end)) = self.objects.get(id) else { return error(libc::EBADF) };
        let next = end.reads.and_then(|pipe| self.objects.pipe(pipe)?.peek().map(<[u8]>::to_vec));
        let Some(next) = next else { return error(libc::EAGAIN) };
        let mut taken = 0;
        for (at, len) in parts {
            let part = (*len).min(next.len() - taken);
            self.write(task, *at, &next[taken..taken + part])?;
            taken += part;
        }
        done(if flags & libc::MSG_TRUNC != 0 { next.len() } else { taken } as i64)
    }

    fn answer_netlink(&mut self, id: ObjectId, port: u32, request: &[u8]) -> Result<(), Errno> {
        if request.len() < HEADER {
            return Err(Errno(libc::EINVAL));
        }
        let half = |at: usize| u16::from_ne_bytes([request[at], request[at + 1]]);
        let (kind, flags) = (half(4), half(6));
        let sequence = [request[8], request[9], request[10], request[11]];
        let mut answer = Vec::new();
        let mut say = |kind: u16, flags: u16, body: &[u8]| {
            let length = (HEADER + body.len()) as u32;
            answer.extend(length.to_ne_bytes());
            answer.extend(kind.to_ne_bytes());
            answer.extend(flags.to_ne_bytes());
            answer.extend(sequence);
            answer.extend(port.to_ne_bytes());
            answer.extend(body);
        };
        let dumps = flags & DUMP != 0;
        match kind {
            GET_LINK if dumps => {
                for place in 0..self.options.interfaces.len() {
                    say(NEW_LINK, MULTI, &self.link(place));
                }
                say(DONE, MULTI, &[0; 4]);
            }
            GET_LINK => {
                let wanted = request.get(20..24).and_then(|bytes| bytes.first_chunk());
                let wanted = wanted.map_or(0, |bytes| i32::from_ne_bytes(*bytes));
                let name = name_of_request(request);
                let by_name = self.options.interfaces.iter().position(|known| *known == name);
                match self.interface_of(wanted).ok().or(by_name) {
                    Some(place) => say(NEW_LINK, 0, &self.link(place)),
                    None => say(ERROR, 0, &refusal(libc::ENODEV, request)),
                }
            }
            // The virtual interfaces have no addresses.
            GET_ADDRESS if dumps => say(DONE, MULTI, &[0; 4]),
            _ => say(ERROR, 0, &refusal(libc::EOPNOTSUPP, request)),
        }
        let Some(&Kind::Pipe(end)) = self.objects.get(id) else { return Err(Errno(libc::EBADF)) };
        let pipe = end.reads.and_then(|pipe| self.objects.pipe(pipe));
        pipe.and_then(|pipe| pipe.write(&answer)).ok_or(Errno(libc::ENOBUFS))?;
        self.objects.changed(id);
        self.touch(&[id]);
        Ok(())
    }

    /// The description of an interface.
    fn link(&self, place: usize) -> Vec<u8> {
        let mut about = vec![0; ABOUT];
        about[2..4].copy_from_slice(&1u16.to_ne_bytes());
        about[4..8].copy_from_slice(&(FIRST_INTERFACE + place as i32).to_ne_bytes());
        let flags = libc::IFF_UP | libc::IFF_RUNNING | libc::IFF_BROADCAST | libc::IFF_MULTICAST;
        about[8..12].copy_from_slice(&(flags as u32).to_ne_bytes());
        let name = [self.options.interfaces[place].as_bytes(), &[0]].concat();
        attribute(&mut about, NAME, &name);
        attribute(&mut about, MTU, &1500u32.to_ne_bytes());
        attribute(&mut about, ADDRESS, &self.mac(place));
        attribute(&mut about, BROADCAST, &[0xFF; 6]);
        about
    }
}

fn attribute(to: &mut Vec<u8>, kind: u16, value: &[u8]) {
    to.extend((4 + value.len() as u16).to_ne_bytes());
    to.extend(kind.to_ne_bytes());
    to.extend(value);
    to.resize(to.len().next_multiple_of(4), 0);
}

/// The name of the interface in a request; empty if there is none.
fn name_of_request(request: &[u8]) -> String {
    let mut rest = request.get(HEADER + ABOUT..).unwrap_or_default();
    while let [low, high, kind, _, ..] = *rest {
        let length = usize::from(u16::from_ne_bytes([low, high])).max(4);
        let value = rest.get(4..length).unwrap_or_default();
        if u16::from(kind) == NAME {
            return String::from_utf8_lossy(value).trim_end_matches('\0').to_owned();
        }
        rest = rest.get(length.next_multiple_of(4)..).unwrap_or_default();
    }
    String::new()
}

/// An error, with the header of the request.
fn refusal(errno: i32, request: &[u8]) -> Vec<u8> {
    let mut body = (-errno).to_ne_bytes().to_vec();
    body.extend(&request[..HEADER]);
    body
}

/// Builds a `sockaddr_nl`.
fn address(port: u32) -> Vec<u8> {
    let mut address = vec![0; 12];
    address[..2].copy_from_slice(&(libc::AF_NETLINK as u16).to_ne_bytes());
    address[4..8].copy_from_slice(&port.to_ne_bytes());
    address
}
