//! Requests of the application: accesses to objects and memory.

use alloc::vec::Vec;

use isocat_wire::{ObjectAddress, StationAddress};

use super::MainDevice;
use super::background::Kind;
use super::procedures::{About, Ended};
use super::way::Activity;
use crate::coe;
use crate::error::{MailboxError, SdoError, SdoResult};
use crate::event::{Event, RequestId};
use crate::mailbox::Mailbox;
use crate::segment::SubDevice;

/// An object access that waits for its mailbox.
pub(super) struct Job {
    request: RequestId,
    pub(super) position: usize,
    object: ObjectAddress,
    /// `None`: an upload.
    download: Option<Vec<u8>>,
}

/// Requests.
impl MainDevice {
    /// Requests an upload of an entry; the bytes come as [`Event::Uploaded`]. Before PREOP, or
    /// without a CoE mailbox, the answer is an error.
    pub fn upload(&mut self, position: usize, object: ObjectAddress) -> RequestId {
        self.request(position, object, None)
    }

    /// Requests a download to an entry; the result comes as [`Event::Downloaded`].
    pub fn download(&mut self, position: usize, object: ObjectAddress, data: &[u8]) -> RequestId {
        self.request(position, object, Some(data.to_vec()))
    }

    /// Requests `len` bytes of the memory of the SubDevice at `position`, including registers; they
    /// come as [`Event::Read`]. A working counter other than 1 is an error. A request in flight
    /// when the run ends gets no answer.
    pub fn read_memory(&mut self, position: usize, address: u16, len: usize) -> RequestId {
        let request = self.next_request();
        let station = self.segment.devices.get(position).map(|device| device.station);
        // An unknown position gets an address that no SubDevice has after the scan.
        let station = station.unwrap_or(StationAddress(0));
        self.lend(|machine| {
            let exchange = machine.link.fprd(station, address, len);
            machine.procedures.start(Kind::Read, About::position(position), async move {
                Ended::Read(request, exchange.expect(1).await.map(|reply| reply.data))
            });
        });
        self.work();
        request
    }

    fn request(
        &mut self,
        position: usize,
        object: ObjectAddress,
        download: Option<Vec<u8>>,
    ) -> RequestId {
        let request = self.next_request();
        self.jobs.push_back(Job { request, position, object, download });
        self.work();
        request
    }

    fn next_request(&mut self) -> RequestId {
        let request = RequestId(self.next_request);
        self.next_request = self.next_request.wrapping_add(1);
        request
    }

    /// Ends the reads that have their answer.
    pub(super) fn work_on_reads(&mut self) {
        let mut from = 0;
        while let Some(ended) = self.procedures.go_on(Kind::Read, &mut from) {
            let Ended::Read(request, result) = ended else { continue };
            self.link.report(Event::Read { request, result });
        }
    }

    /// Ends the requests that have their answer, and starts those whose mailbox is free.
    pub(super) fn work_on_requests(&mut self) {
        let mut from = 0;
        while let Some(ended) = self.procedures.go_on(Kind::Request, &mut from) {
            let Ended::Request { request, position, is_download, answer } = ended else { continue };
            let (mailbox, result) = answer;
            if let Some(place) = self.mailboxes.get_mut(position) {
                *place = Some(mailbox);
            }
            self.answer(request, is_download, result);
        }
        let mut at = 0;
        while at < self.jobs.len() {
            let position = self.jobs[at].position;
            let busy = self.procedures.has_at(Kind::Request, position)
                || self.procedures.has_at(Kind::Entry, position)
                || self.jobs.iter().take(at).any(|job| job.position == position);
            // During bring-up the mailboxes are in use, so requests wait.
            let on_the_way = matches!(self.activity, Activity::Task(..)) && !self.stopping;
            if busy || on_the_way {
                at += 1;
                continue;
            }
            let has_coe = self.segment.devices.get(position).is_some_and(SubDevice::has_coe);
            let mailbox = self.mailboxes.get_mut(position).filter(|_| has_coe);
            let mailbox = mailbox.and_then(Option::take);
            let Some(job) = self.jobs.remove(at) else { continue };
            match mailbox {
                Some(mailbox) => self.run(job, mailbox),
                None => self.refuse(job.request, job.download.is_some()),
            }
        }
    }

    fn run(&mut self, job: Job, mut mailbox: Mailbox) {
        let Job { request, position, object, download } = job;
        let is_download = download.is_some();
        let about = About { position: Some(position), request: Some((request, is_download)) };
        self.procedures.start(Kind::Request, about, async move {
            let result = match download {
                Some(data) => {
                    coe::download(&mut mailbox, object, &data, false).await.map(|()| Vec::new())
                }
                None => coe::upload(&mut mailbox, object, false).await,
            };
            Ended::Request { request, position, is_download, answer: (mailbox, result) }
        });
    }

    fn answer(&mut self, request: RequestId, is_download: bool, result: SdoResult) {
        self.link.report(match is_download {
            true => Event::Downloaded { request, result: result.map(|_| ()) },
            false => Event::Uploaded { request, result },
        });
    }

    /// Answers all waiting requests with an error, and those that were under way.
    pub(super) fn refuse_all(&mut self, under_way: &[About]) {
        while let Some(job) = self.jobs.pop_front() {
            self.refuse(job.request, job.download.is_some());
        }
        self.refuse_these(under_way);
    }

    /// Answers these requests with an error.
    pub(super) fn refuse_these(&mut self, under_way: &[About]) {
        for (request, is_download) in under_way.iter().filter_map(|about| about.request) {
            self.refuse(request, is_download);
        }
    }

    fn refuse(&mut self, request: RequestId, is_download: bool) {
        self.answer(request, is_download, Err(SdoError::Mailbox(MailboxError::Absent)));
    }
}
