//! The program in a process: its clocks are patched before its first call.

use std::fs;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;

use super::vdso::{self, PAGE_DESCRIPTOR, Patch, Vdso};
use super::{Supervisor, counter};
use crate::kernel::TaskId;
use crate::sys;

impl Supervisor<'_> {
    /// Checks whether the program was replaced, before its first call is answered. `false`: the
    /// thread already runs again.
    pub(super) fn prepare_image(&mut self, task: TaskId) -> io::Result<bool> {
        let call = self.thread(task).call;
        if call.number == libc::SYS_close && self.process(task).under.is_some() {
            return self.page_mapped(task).map(|()| true);
        }
        if self.process(task).prepared || call.number == libc::SYS_execve {
            return Ok(true);
        }
        self.process(task).prepared = true;
        let number = self.process(task).number;
        let Some(vdso) = fresh_vdso(number)? else {
            // The program was not replaced after all.
            return Ok(true);
        };
        self.new_image(task);
        if counter::is_read_by(number) {
            self.note("a program's code reads the processor's own counter (RDTSC), which shows real time: what depends on it differs from run to run");
        }
        let memory = fs::OpenOptions::new().write(true).open(format!("/proc/{number}/mem"))?;
        let mut random = [0; 16];
        self.host.random(&mut random);
        memory.write_all_at(&random, auxiliary(number, libc::AT_RANDOM)?)?;
        for patch in vdso.patches() {
            memory.write_all_at(&patch.bytes, patch.address)?;
        }
        if let Some((clock, stub)) = vdso.counting_clock(call.behind) {
            let added = self.listener().add_descriptor(
                call.id,
                self.page.file.as_fd(),
                Some(PAGE_DESCRIPTOR),
                false,
            );
            let is_added = match added {
                Ok(_) => true,
                // The program's limit of descriptors is below this number, so that its clocks stop
                // at the supervisor; or the thread was killed meanwhile.
                Err(error) if matches!(error.raw_os_error(), Some(libc::EBADF | libc::ENOENT)) => {
                    false
                }
                // Not a run that is slower and otherwise than the next one.
                Err(error) => return Err(error),
            };
            if is_added {
                memory.write_all_at(&clock.bytes, clock.address)?;
                let jump = vdso::jump(stub);
                let mut under = vec![0; jump.len()];
                sys::read_memory(number, call.behind, &mut under)?;
                memory.write_all_at(&jump, call.behind)?;
                self.process(task).under = Some(Patch { address: call.behind, bytes: under });
            }
        }
        Ok(true)
    }

    /// A process that was made by `vfork` now has its own program: its parent continues at this
    /// moment, and its next call is awaited.
    pub(super) fn let_parent_run(&mut self, task: TaskId) -> io::Result<()> {
        let is_exec = self.thread(task).call.number == libc::SYS_execve;
        let process = self.process(task);
        let number = process.number;
        if process.prepared
            || is_exec
            || process.stands_for.is_none()
            || fresh_vdso(number)?.is_none()
        {
            return Ok(());
        }
        if let Some(parent) = self.process(task).stands_for.take() {
            self.run_unless_stopped(parent);
        }
        Ok(())
    }

    /// Notes that a thread runs again without a reply from here; it may have made its next call
    /// already.
    pub(super) fn run_unless_stopped(&mut self, task: TaskId) {
        if !self.thread(task).stopped {
            self.scheduler.run(task);
        }
    }

    /// The program has mapped the clock's page: restores the program's own instructions.
    fn page_mapped(&mut self, task: TaskId) -> io::Result<()> {
        let call = self.thread(task).call;
        let number = self.process(task).number;
        if let Some(patch) =
            self.process(task).under.take_if(|_| call.arguments[0] == u64::from(PAGE_DESCRIPTOR))
        {
            let memory = fs::OpenOptions::new().write(true).open(format!("/proc/{number}/mem"))?;
            memory.write_all_at(&patch.bytes, patch.address)?;
            if call.arguments[1] != vdso::PAGE {
                return Err(io::Error::other("the clock's page could not be mapped"));
            }
        }
        Ok(())
    }

    /// Another program runs in the process: removes what it does not inherit.
    fn new_image(&mut self, task: TaskId) {
        self.replaced_by(task);
        let process = self.process(task);
        process.space = process.number as u64 | 1 << 40;
        process.timers.clear();
        let closed: Vec<i32> = process
            .descriptors
            .iter()
            .filter(|(_, descriptor)| descriptor.close_on_exec)
            .map(|(number, _)| *number)
            .collect();
        for number in closed {
            self.forget_descriptor(task, number);
        }
    }
}

/// A value that the kernel passed to the program at its start.
fn auxiliary(process: i32, wanted: libc::c_ulong) -> io::Result<u64> {
    let bytes = fs::read(format!("/proc/{process}/auxv"))?;
    let word = |bytes: &[u8]| bytes.first_chunk().map_or(0, |word| u64::from_ne_bytes(*word));
    let pairs = bytes.chunks_exact(16).map(|pair| (word(&pair[..8]), word(&pair[8..])));
    let found = pairs.into_iter().find(|(kind, _)| *kind == wanted);
    let missing = || io::Error::other(format!("the program has no auxiliary value {wanted}"));
    found.map(|(_, value)| value).ok_or_else(missing)
}

/// The vdso of a program, if it is still as the kernel mapped it.
fn fresh_vdso(process: i32) -> io::Result<Option<Vdso>> {
    let base = auxiliary(process, libc::AT_SYSINFO_EHDR)?;
    let image = image_of_vdso(process, base)?;
    let missing = || io::Error::other("the program's vdso has no clock_gettime");
    let vdso = Vdso::parse(base, &image).ok_or_else(missing)?;
    let (at, done) = vdso.first();
    let mut begins = vec![0; done.len()];
    sys::read_memory(process, at, &mut begins)?;
    let is_done = begins == done || vdso::is_counting(&begins);
    Ok((!is_done).then_some(vdso))
}

/// The bytes of the vdso that is mapped at `base`.
fn image_of_vdso(process: i32, base: u64) -> io::Result<Vec<u8>> {
    let maps = fs::read_to_string(format!("/proc/{process}/maps"))?;
    let range = maps.lines().filter_map(|line| {
        let (from, to) = line.split(' ').next()?.split_once('-')?;
        Some((u64::from_str_radix(from, 16).ok()?, u64::from_str_radix(to, 16).ok()?))
    });
    let missing = || io::Error::other("the program has no vdso");
    let (from, to) = range.into_iter().find(|(from, _)| *from == base).ok_or_else(missing)?;
    let mut image = vec![0; (to - from) as usize];
    sys::read_memory(process, from, &mut image)?;
    Ok(image)
}
