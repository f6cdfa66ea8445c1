//! The mailbox of the SubDevice: SM0 in, SM1 out, counters, errors, repetition.

use isocat_esc::{Pdi, PdiExt};
use isocat_wire::mailbox::{ErrorDetail, HEADER_LEN, Header, Protocol, next_counter};
use isocat_wire::register::{self, al_event};
use isocat_wire::sync_manager::SyncManager;

use crate::application::Application;
use crate::coe::Outcome;
use crate::description;
use crate::objects::Objects;
use crate::services::Services;

/// Most bytes of a mailbox, header included. The stack keeps two messages of this size: the last one
/// may be asked for again, even when the next already waits.
pub const MAX_MAILBOX: usize = 1024;
/// Least bytes of a mailbox: header, CoE header, an SDO with four bytes, and room for a segment.
pub const MIN_MAILBOX: usize = 24;

/// State of the two mailboxes.
pub(crate) struct Mailbox {
    areas: Option<description::Mailbox>,
    running: bool,
    /// Counter of the message received last; 0 before the first.
    received: u8,
    /// Counter of the message sent last; 0 before the first.
    sent: u8,
    /// The last two messages sent.
    messages: [Message; 2],
    /// Which of them is the later one.
    latest: usize,
    /// Which of them stands in SM1, or stood there last.
    shown: usize,
    /// Which of them the MainDevice read last; that one it may have lost.
    read: Option<usize>,
    /// A message stands in SM1 and was not read yet.
    occupied: bool,
    /// The latest message had to make room for a repetition and is due again.
    again: bool,
    /// SM1 holds an answer of the time before INIT, which nobody shall take for a new one.
    stale: bool,
    /// SM1 is being emptied.
    emptying: Option<Emptying>,
}

#[derive(Clone, Copy)]
struct Message {
    bytes: [u8; MAX_MAILBOX],
    /// 0 before the first.
    len: usize,
}

impl Mailbox {
    /// A mailbox that is off.
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
            messages: [Message { bytes: [0; MAX_MAILBOX], len: 0 }; 2],
            latest: 0,
            shown: 0,
            read: None,
            occupied: false,
            again: false,
            stale: false,
            emptying: None,
        }
    }

    /// PREOP is entered: counters start anew, the repeat bit is taken as it stands, and what still stands in
    /// SM1 is dropped at the next look.
    pub fn start(&mut self, pdi: &mut impl Pdi) {
        self.stop();
        self.running = self.areas.is_some();
        if self.running {
            let asked = pdi.load(register::sm_activate(SEND)) & SyncManager::REPEAT;
            pdi.store(register::sm_pdi_control(SEND), asked);
            self.stale = pdi.load(register::sm_status(SEND)) & SyncManager::STATUS_FULL != 0;
        }
    }

    /// INIT is entered.
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
        for message in &mut self.messages {
            message.len = 0;
        }
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

    /// The MainDevice may have toggled the repeat bit: it lost the message that it read last.
    pub fn check_repeat(&mut self, pdi: &mut impl Pdi) {
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
                // A newer message may stand there already: it gives way and comes again afterwards.
                let occupied = full || self.is_repeating();
                if occupied && !self.empty_send_mailbox(sm.pdi_control & SyncManager::REPEAT, pdi) {
                    return;
                }
                self.put(lost, pdi);
                self.again = lost != self.latest;
            }
            None => {}
        }
        pdi.store(register::sm_pdi_control(SEND), asked);
    }

    /// Takes and gives messages, as far as the SyncManagers allow.
    pub fn poll<A: Application, S: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        events: u32,
        services: &mut Services,
        objects: &mut Objects<'_, A, S>,
        pdi: &mut impl Pdi,
    ) {
        let Some(areas) = self.areas else { return };
        let was_read = events & al_event::sync_manager(SEND) != 0;
        if was_read {
            self.was_read();
        }
        if !self.occupied && core::mem::take(&mut self.again) {
            self.put(self.latest, pdi);
        }
        if !self.occupied
            && let Some(protocol) = services.has_more()
        {
            self.reply(protocol, pdi, |body| services.more(protocol, objects, body));
        }
        if !self.occupied && events & al_event::sync_manager(RECEIVE) != 0 {
            let mut request = [0; MAX_MAILBOX];
            let request = &mut request[..usize::from(areas.receive.length)];
            pdi.read(areas.receive.start, request);
            self.receive(request, services, objects, pdi);
        }
        if was_read && !self.occupied {
            // Writing its first byte releases the event of the mailbox that was read.
            pdi.write(areas.send.start, &[0]);
        }
    }

    fn receive<A: Application, S: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        request: &[u8],
        services: &mut Services,
        objects: &mut Objects<'_, A, S>,
        pdi: &mut impl Pdi,
    ) {
        let Some((header, body)) = request.split_first_chunk::<HEADER_LEN>() else { return };
        let header = Header::parse(header);
        if header.counter != 0 && header.counter == self.received {
            return;
        }
        self.received = header.counter;
        // An error message of the MainDevice wants no answer, least of all an error.
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
        self.reply(protocol, pdi, |answer| match fault {
            Some(detail) => Outcome::Error(detail),
            None => {
                let request = &body[..usize::from(header.length)];
                services.handle(protocol, request, objects, answer)
            }
        });
    }

    /// Makes a message of what `fill` puts behind the mailbox header, and sends it.
    fn reply(
        &mut self,
        protocol: Protocol,
        pdi: &mut impl Pdi,
        fill: impl FnOnce(&mut [u8]) -> Outcome,
    ) {
        let Some(areas) = self.areas else { return };
        let next = 1 - self.latest;
        let counter = next_counter(self.sent);
        let mut header = Header::new(0, MAIN_DEVICE, protocol, counter);
        let (head, body) = self.messages[next].bytes.split_at_mut(HEADER_LEN);
        let room = usize::from(areas.send.length) - HEADER_LEN;
        let len = match fill(&mut body[..room]) {
            Outcome::Reply(len) => len.min(room),
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
        self.messages[next].len = HEADER_LEN + len;
        self.sent = counter;
        self.latest = next;
        self.put(next, pdi);
    }

    /// Puts a message into SM1. What lies behind it is of no meaning; the last byte closes the
    /// mailbox.
    fn put(&mut self, which: usize, pdi: &mut impl Pdi) {
        let Some(areas) = self.areas else { return };
        let message = &self.messages[which];
        pdi.write(areas.send.start, &message.bytes[..message.len]);
        if message.len < usize::from(areas.send.length) {
            pdi.write(areas.send.start + (areas.send.length - 1), &[0]);
        }
        self.occupied = true;
        self.shown = which;
    }

    /// The MainDevice has read what stood in SM1.
    fn was_read(&mut self) {
        if core::mem::take(&mut self.occupied) {
            self.read = Some(self.shown);
        }
    }

    /// Empties SM1 by switching it off and on. The ESC does each at the end of the frame that is passing;
    /// `false` as long as it has not done both.
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

/// How far SM1 has come on its way to be emptied.
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
