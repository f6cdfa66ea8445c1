//! Start-up lists (ENI), our own and foreign ones, played on a virtual segment.

mod export_and_run;
mod foreign;
mod own_export;
