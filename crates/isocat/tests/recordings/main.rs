//! What is kept of a run and read again: captures, traces, series, pages, diagnoses of captures.

mod capture;
mod diagnose;
mod diagnose_accuracy;
mod diagnose_bad_input;
mod diagnose_claims;
mod diagnose_forms;
mod diagnose_rhythms;
mod pages;
mod record;
mod recording;
mod replay;
mod series;
mod trace;
mod waves;
