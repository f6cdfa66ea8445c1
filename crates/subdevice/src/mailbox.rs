//! The mailbox of the SubDevice: SM0 for requests, SM1 for answers, with counters, errors and
//! repetition.

use isocat_esc::{Pdi, PdiExt};
use isocat_wire::mailbox::{ErrorDetail, HEADER_LEN, Header, Protocol, next_counter};
use isocat_wire::register::{self, al_event};
use isocat_wire::sync_manager::SyncManager;

use crate::application::Application;
use crate::coe::Outcome;
use crate::description;
use crate::dictionary::Room;
use crate::objects::{MAX_TRANSFER, Objects};
use crate::services::Services;

/// Most bytes of a mailbox, including the header.
pub const MAX_MAILBOX: usize = 1024;
/// Least bytes of a mailbox: header, CoE header, an SDO with four bytes, and space for a segment.
pub const MIN_MAILBOX: usize = 24;

/// State of the two mailboxes.
///
/// The last two messages sent are in the [`Room`]: the MainDevice may request the last one again
/// even when the next one already waits.
pub(crate) struct Mailbox {
    areas: Option<description::Mailbox>,
    running: bool,
    /// Counter of the last message received; 0 before the first.
    received: u8,
    /// Counter of the last message sent; 0 before the first.
    sent: u8,
    /// Bytes of the last two messages sent; 0 before the first.
    sent_len: [u16; 2],
    /// Index of the later one.
    latest: usize,
    /// Index of the message that is in SM1, or was last in it.
    shown: usize,
    /// Index of the message that the MainDevice read last, and may have lost.
    read: Option<usize>,
    /// Whether a message is in SM1 that was not read yet.
    occupied: bool,
    /// Whether the latest message was replaced by a repetition and must be sent again.
    again: bool,
    /// Whether SM1 holds an answer from before INIT, which must not be taken for a new one.
    stale: bool,
    /// The state of emptying SM1, while it is being emptied.
    emptying: Option<Emptying>,
}

impl Mailbox {
    /// A mailbox that is switched off.
    pub fn new(areas: Option<description::Mailbox>) -> Self {
        for area in areas.iter().flat_map(|areas| [areas.receive, areas.send]) {
            assert!(
                (MIN_MAILBOX..=MAX_MAILBOX).contains(&usize::from(area.length)),
                "a mailbox must have {MIN_MAILBOX} to {MAX_MAILBOX} bytes, not {}",
                area.length
            );
        }
        Self {
            areas,
            running: false,
            received: 0,
            sent: 0,
            sent_len: [0; 2],
            latest: 0,
            shown: 0,
            read: None,
            occupied: false,
            again: false,
            stale: false,
            emptying: None,
        }
    }

    /// Starts at PREOP: counters start again, the present repeat bit is taken over, and an old
    /// message in SM1 is dropped at the next call of [`Self::poll`].
    pub fn start(&mut self, pdi: &mut impl Pdi) {
        self.stop();
        self.running = self.areas.is_some();
        if self.running {
            let asked = pdi.load(register::sm_activate(SEND)) & SyncManager::REPEAT;
            pdi.store(register::sm_pdi_control(SEND), asked);
            self.stale = pdi.load(register::sm_status(SEND)) & SyncManager::STATUS_FULL != 0;
        }
    }

    /// Stops at INIT.
    pub fn stop(&mut self) {
        self.running = false;
        self.received = 0;
        self.sent = 0;
        self.latest = 0;
        self.read = None;
        self.occupied = false;
        self.again = false;
        self.stale = false;
        self.emptying = None;
        self.sent_len = [0; 2];
    }

    /// Whether these events concern the mailbox.
    pub fn wants(&self, events: u32) -> bool {
        let own = al_event::sync_manager(RECEIVE) | al_event::sync_manager(SEND);
        self.running && !self.is_repeating() && events & own != 0
    }

    /// Whether a message waits until the ESC has emptied SM1.
    pub fn is_repeating(&self) -> bool {
        self.stale || self.emptying.is_some()
    }

    /// Handles a toggled repeat bit: the MainDevice lost the message that it read last.
    pub fn check_repeat(&mut self, room: &Room<'_>, pdi: &mut impl Pdi) {
        if !self.running {
            return;
        }
        let mut sm: SyncManager = pdi.load(register::sync_manager(SEND));
        if self.stale {
            if !self.empty_send_mailbox(sm.pdi_control & SyncManager::REPEAT, pdi) {
                return;
            }
            self.stale = false;
            sm = pdi.load(register::sync_manager(SEND));
        }
        let asked = sm.activate & SyncManager::REPEAT;
        if asked == sm.pdi_control & SyncManager::REPEAT {
            return;
        }
        let full = sm.status & SyncManager::STATUS_FULL != 0;
        if !full && !self.is_repeating() {
            self.was_read();
        }
        match self.read {
            Some(lost) if full && self.shown == lost => {}
            Some(lost) => {
                // A newer message may already be in SM1: the repetition replaces it, and it is sent
                // again afterwards.
                let occupied = full || self.is_repeating();
                if occupied && !self.empty_send_mailbox(sm.pdi_control & SyncManager::REPEAT, pdi) {
                    return;
                }
                self.put(lost, room, pdi);
                self.again = lost != self.latest;
            }
            None => {}
        }
        pdi.store(register::sm_pdi_control(SEND), asked);
    }

    /// Takes requests and gives answers, as far as the SyncManagers allow.
    pub fn poll<A: Application>(
        &mut self,
        events: u32,
        services: &mut Services,
        objects: &mut Objects<'_, A>,
        room: &mut Room<'_>,
        pdi: &mut impl Pdi,
    ) {
        let Some(areas) = self.areas else { return };
        let was_read = events & al_event::sync_manager(SEND) != 0;
        if was_read {
            self.was_read();
        }
        if !self.occupied && core::mem::take(&mut self.again) {
            self.put(self.latest, room, pdi);
        }
        if !self.occupied
            && let Some(protocol) = services.has_more()
        {
            self.reply(protocol, room, pdi, |body, transfer| {
                services.more(protocol, objects, transfer, body)
            });
        }
        if !self.occupied && events & al_event::sync_manager(RECEIVE) != 0 {
            let mut request = [0; MAX_MAILBOX];
            let request = &mut request[..usize::from(areas.receive.length)];
            pdi.read(areas.receive.start, request);
            self.receive(request, services, objects, room, pdi);
        }
        if was_read && !self.occupied {
            // Writing its first byte acknowledges the event of the read mailbox.
            pdi.write(areas.send.start, &[0]);
        }
    }

    fn receive<A: Application>(
        &mut self,
        request: &[u8],
        services: &mut Services,
        objects: &mut Objects<'_, A>,
        room: &mut Room<'_>,
        pdi: &mut impl Pdi,
    ) {
        let Some((header, body)) = request.split_first_chunk::<HEADER_LEN>() else { return };
        let header = Header::parse(header);
        if header.counter != 0 && header.counter == self.received {
            return;
        }
        self.received = header.counter;
        // An error message of the MainDevice needs no answer, in particular no error.
        if header.protocol == Protocol::ERROR {
            return;
        }
        let fault = if header.channel & CHANNEL != 0 {
            Some(ErrorDetail::INVALID_CHANNEL)
        } else if usize::from(header.length) > body.len() {
            Some(ErrorDetail::INVALID_SIZE)
        } else if header.length == 0 {
            Some(ErrorDetail::SIZE_TOO_SHORT)
        } else {
            None
        };
        let protocol = header.protocol;
        self.reply(protocol, room, pdi, |answer, transfer| match fault {
            Some(detail) => Outcome::Error(detail),
            None => {
                let request = &body[..usize::from(header.length)];
                services.handle(protocol, request, objects, transfer, answer)
            }
        });
    }

    /// Makes a message from the bytes that `fill` writes after the mailbox header, and sends it.
    /// `fill` gets the data of the present transfer, too.
    fn reply(
        &mut self,
        protocol: Protocol,
        room: &mut Room<'_>,
        pdi: &mut impl Pdi,
        fill: impl FnOnce(&mut [u8], &mut [u8; MAX_TRANSFER]) -> Outcome,
    ) {
        let next = 1 - self.latest;
        let counter = next_counter(self.sent);
        let mut header = Header::new(0, MAIN_DEVICE, protocol, counter);
        let (head, body) = room.messages[next].split_at_mut(HEADER_LEN);
        let len = match fill(body, room.transfer) {
            Outcome::Reply(len) => len.min(body.len()),
            Outcome::Silent => return,
            Outcome::Error(detail) => {
                header.protocol = Protocol::ERROR;
                let data = detail.emit();
                body[..data.len()].copy_from_slice(&data);
                data.len()
            }
        };
        header.length = len as u16;
        head.copy_from_slice(&header.emit());
        self.sent_len[next] = (HEADER_LEN + len) as u16;
        self.sent = counter;
        self.latest = next;
        self.put(next, room, pdi);
    }

    /// Writes a message into SM1. Bytes after the message have no meaning; the last byte closes the
    /// mailbox.
    fn put(&mut self, which: usize, room: &Room<'_>, pdi: &mut impl Pdi) {
        let Some(areas) = self.areas else { return };
        let len = self.sent_len[which];
        pdi.write(areas.send.start, &room.messages[which][..usize::from(len)]);
        if len < areas.send.length {
            pdi.write(areas.send.start + (areas.send.length - 1), &[0]);
        }
        self.occupied = true;
        self.shown = which;
    }

    /// Called when the MainDevice has read SM1.
    fn was_read(&mut self) {
        if core::mem::take(&mut self.occupied) {
            self.read = Some(self.shown);
        }
    }

    /// Empties SM1 by switching it off and on. The ESC does each at the end of the present frame;
    /// returns `false` until it has done both.
    fn empty_send_mailbox(&mut self, repeat: u8, pdi: &mut impl Pdi) -> bool {
        let control = register::sm_pdi_control(SEND);
        let mut phase = self.emptying.take().unwrap_or(Emptying::SwitchingOff);
        if phase == Emptying::SwitchingOff {
            pdi.store(control, repeat | SWITCHED_OFF);
            if pdi.load(control) & SWITCHED_OFF != 0 {
                phase = Emptying::SwitchingOn;
            }
        }
        if phase == Emptying::SwitchingOn {
            pdi.store(control, repeat);
            if pdi.load(control) & SWITCHED_OFF == 0 {
                return true;
            }
        }
        self.emptying = Some(phase);
        false
    }
}

/// The progress of emptying SM1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Emptying {
    SwitchingOff,
    SwitchingOn,
}

/// SyncManager of the mailbox towards the SubDevice.
const RECEIVE: usize = 0;
/// SyncManager of the mailbox towards the MainDevice.
const SEND: usize = 1;
/// Address of the MainDevice in a mailbox header.
const MAIN_DEVICE: u16 = 0;
/// Bits of the channel in a mailbox header; it must be 0.
const CHANNEL: u8 = 0x3F;
/// PDI control bit 0.
const SWITCHED_OFF: u8 = 0x01;
