//! The screen: head, host phase, table of SubDevices, events, keys.

use isocat_engine::status::{Device, Event, SUBS, Status, servo_name};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Cell, Clear, Paragraph, Row, Table, TableState, Wrap};

use super::view::{Page, Sort, View};
use super::{cycle, words};

/// Draws the view.
pub fn draw(frame: &mut Frame<'_>, view: &View) {
    let area = frame.area();
    let events = match area.height {
        0..=13 => 0,
        14..=30 => 5,
        height => height / 4,
    };
    let [head, body, log, keys] = Layout::vertical([
        Constraint::Length(HEAD),
        Constraint::Min(2),
        Constraint::Length(events),
        Constraint::Length(1),
    ])
    .areas(area);
    let Some(status) = view.trend().status() else {
        frame.render_widget(Paragraph::new("isocat watch: nothing is known yet"), area);
        return;
    };
    draw_head(frame, head, view, status);
    match (view.page(), view.current()) {
        (Page::Cycle, Some(device)) => cycle::draw(frame, body, view, status, device),
        _ => draw_table(frame, body, view, status),
    }
    draw_log(frame, log, view);
    draw_keys(frame, keys, view);
    if let Page::Help { .. } = view.page() {
        draw_help(frame, area, view);
    }
}

/// Lines above the table.
const HEAD: u16 = 5;

/// The style, with colours if enabled; bold, reversed and dim are always used.
pub(super) struct Look(pub bool);

impl Look {
    pub fn good(&self) -> Style {
        self.of(Color::Green).add_modifier(Modifier::BOLD)
    }
    pub fn bad(&self) -> Style {
        self.of(Color::Red).add_modifier(Modifier::BOLD)
    }
    pub fn quiet(&self) -> Style {
        Style::new().add_modifier(Modifier::DIM)
    }
    pub fn head(&self) -> Style {
        Style::new().add_modifier(Modifier::BOLD | Modifier::UNDERLINED)
    }
    fn of(&self, colour: Color) -> Style {
        if self.0 { Style::new().fg(colour) } else { Style::new() }
    }
}

fn draw_head(frame: &mut Frame<'_>, area: Rect, view: &View, status: &Status) {
    let look = Look(view.colour);
    let width = usize::from(area.width);
    let paused = if view.is_paused() { "PAUSED  " } else { "" };
    let right = format!("{paused}{}  {}", view.title, words::seconds(status.at_ns));
    let left = format!("isocat watch  {}", status.segment);
    let left = words::cut(&left, width.saturating_sub(right.chars().count() + 2));
    let gap = width.saturating_sub(left.chars().count() + right.chars().count());
    let verdict = status.verdict();
    let style = if verdict.good { look.good() } else { look.bad() };
    let host = &status.host;
    let operation = status.operation_ns.map_or("-".to_owned(), words::seconds);
    let servo = host.servo.map_or("-", servo_name);
    let rate = host.rate_ppm.map_or("-".to_owned(), |ppm| format!("{ppm:+.2} ppm"));
    let cycle = words::cycle(status.cycle_ns);
    let mut state = format!("cycle {cycle}  in operation {operation}  servo {servo}, {rate} [m]");
    if status.kind == isocat_engine::status::Kind::Served {
        state = format!("cycle {cycle}  in operation {operation}  MainDevice: external");
    }
    let counts = format!(
        "frames {} sent, {} lost  working counter errors {}  skipped {}  locks lost {} [m]",
        host.frames_sent,
        host.frames_lost,
        host.working_counter_errors,
        host.cycles_skipped,
        host.locks_lost
    );
    let phase = format!(
        "host phase {:>9}, worst {:>9} [{}] ",
        words::maybe(host.phase_error_ns),
        words::maybe(host.phase_error_worst_ns),
        status.kind.source(),
    );
    let room = width.saturating_sub(phase.chars().count());
    let mut last = vec![Span::raw(phase)];
    last.push(Span::raw(sparkline(view.trend().phases(), room)));
    let lines = vec![
        Line::styled(format!("{left}{:gap$}{right}", ""), look.quiet()),
        Line::styled(words::cut(&headline(view, &verdict.words), width), style),
        Line::raw(words::cut(&state, width)),
        Line::raw(words::cut(&counts, width)),
        Line::from(last),
    ];
    frame.render_widget(Paragraph::new(lines), area);
}

/// The verdict, on the way up with the SubDevice that is behind the others for longest.
fn headline(view: &View, verdict: &str) -> String {
    let trend = view.trend();
    let way_up = trend.status().filter(|status| !status.in_operation() && !status.has_ended());
    let behind = way_up.and_then(|status| Some((status, trend.all_behind().into_iter().next()?)));
    match behind {
        Some((status, behind)) => format!("{verdict}; {}", words::behind(status, &behind)),
        None => verdict.to_owned(),
    }
}

/// The last values as bars from zero to the largest of them.
fn sparkline(
    values: impl DoubleEndedIterator<Item = f64> + ExactSizeIterator,
    width: usize,
) -> String {
    let skip = values.len().saturating_sub(width);
    let values: Vec<f64> = values.skip(skip).map(f64::abs).collect();
    let most = values.iter().copied().fold(0.0, f64::max);
    let bar = |value: &f64| match most > 0.0 {
        true => BARS[((value / most * 7.0).round() as usize).min(7)],
        false => BARS[0],
    };
    values.iter().map(bar).collect()
}

const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Width from which the table has all columns.
const WIDE: u16 = 140;

fn draw_table(frame: &mut Frame<'_>, area: Rect, view: &View, status: &Status) {
    let look = Look(view.colour);
    let wide = area.width >= WIDE;
    let (sort, reverse) = view.sort();
    let arrow = if reverse { '▲' } else { '▼' };
    let head = |words: &str, by: Option<Sort>| {
        let sign = if by == Some(sort) { arrow.to_string() } else { String::new() };
        format!("{words}{sign}")
    };
    let (t, m) = (status.kind.source(), status.kind.margin_source());
    let (error, margin, counts) = match wide {
        true => (format!("error[{t}]"), format!("margin[{m}]"), "counts"),
        false => (format!("err[{t}]"), format!("marg[{m}]"), "cnt"),
    };
    let mut heads: Vec<Cell<'_>> = vec![
        head("#", Some(Sort::Position)).into(),
        head("device", None).into(),
        head("state", None).into(),
        head("mode", None).into(),
        right(head(&error, Some(Sort::Error))),
        right(head("worst", None)),
        right(head(&margin, Some(Sort::Margin))),
        right(head("ppm[r]", Some(Sort::Ppm))),
        right(head(counts, Some(Sort::Counters))),
    ];
    let columns = if wide { [4, 0, 18, 15, 10, 10, 10, 9, 8] } else { [3, 0, 7, 8, 8, 8, 8, 7, 5] };
    let width = |width| match width {
        0 => Constraint::Fill(1),
        width => Constraint::Length(width),
    };
    let mut widths: Vec<Constraint> = columns.map(width).into();
    if wide {
        let more = ["least", "measured", "0x1C32 0B 0C 0D 20", "0x1C33 0B 0C 0D 20", "rate/s"];
        heads.extend(more.map(|words| right(head(words, None))));
        heads.push(head("alarms", None).into());
        widths.extend([10, 10, 18, 18, 7, 20].map(Constraint::Length));
    } else {
        heads.push(head("alarm", None).into());
        widths.push(Constraint::Length(5));
    }
    // Figures are omitted rather than cut: without its first digit a figure would be wrong.
    let kept = kept(area.width);
    keep(&mut heads, kept);
    keep(&mut widths, kept);
    let rows = view.rows().into_iter().map(|device| {
        let mut cells = cells(device, view, wide);
        keep(&mut cells, kept);
        Row::new(cells)
    });
    let table = Table::new(rows, widths)
        .header(Row::new(heads).style(look.head()))
        .column_spacing(1)
        .row_highlight_style(Style::new().add_modifier(Modifier::REVERSED));
    let mut state = TableState::new().with_selected(Some(view.selected_row()));
    frame.render_stateful_widget(table, area, &mut state);
}

/// The columns that fit.
fn kept(width: u16) -> &'static [usize] {
    match width {
        78.. => &[],
        45.. => &[0, 1, 2, 4, 6, 8],
        _ => &[0, 2, 4],
    }
}

/// Keeps the elements at these indices; all if there are none.
fn keep<T>(all: &mut Vec<T>, places: &[usize]) {
    let mut at = 0;
    all.retain(|_| {
        at += 1;
        places.is_empty() || places.contains(&(at - 1))
    });
}

fn cells(device: &Device, view: &View, wide: bool) -> Vec<Cell<'static>> {
    let look = Look(view.colour);
    let limit = view.trend().status().map_or(0, |status| status.limit_ns) as f64;
    let plain = Style::new();
    let state = match (wide, device.al_code) {
        (_, _) if !device.asked => "absent".to_owned(),
        (false, _) if device.al_error => format!("{}!", device.state_name()),
        (true, code @ 1..) => format!("{}, 0x{code:04X}", device.state()),
        _ => device.state(),
    };
    let error = device.error;
    let beyond = error.is_some_and(|error| device.has_sync && error.now_ns.abs() > limit);
    let mode = if wide { &*device.mode } else { short(&device.mode) };
    let margin = device.margin;
    let narrow = margin.is_some_and(|margin| margin.now_ns < 0.0);
    let reference =
        if device.is_reference { "ref".to_owned() } else { words::ppm(device.clock_ppm) };
    let risen = device.risen();
    let read = device.outputs.iter().chain(&device.inputs).any(|counter| counter.value.is_some());
    let counts = match (read, risen) {
        (false, 0) => "-".to_owned(),
        (_, 0) => "0".to_owned(),
        _ => format!("+{risen}"),
    };
    let bad = |is: bool| if is { look.bad() } else { plain };
    let behind = view.trend().behind(device);
    let mut cells = vec![
        Cell::from(device.position.to_string()),
        Cell::from(device.name.clone()),
        Cell::from(state).style(bad(!device.is_in_op())),
        Cell::from(mode.to_owned()),
        right(words::maybe(error.map(|error| error.now_ns))).style(bad(beyond)),
        right(words::maybe(error.map(|error| error.worst_ns))),
        right(words::maybe(margin.map(|margin| margin.now_ns))).style(bad(narrow)),
        right(reference),
        right(counts).style(bad(risen > 0)),
    ];
    let is_told = behind.is_some() || !device.alarms.is_empty();
    let alarms = device.alarms.iter().map(|alarm| &**alarm);
    if wide {
        let least = words::maybe(margin.map(|margin| margin.least_ns));
        let count = error.map_or("-".to_owned(), |error| error.count.to_string());
        let rate = words::rate(view.trend().rate(device.position));
        let behind = behind.map(|behind| format!("behind for {}", words::span(behind.for_ns)));
        let told: Vec<_> = behind.iter().map(String::as_str).chain(alarms).collect();
        let told = if told.is_empty() { "-".to_owned() } else { told.join(", ") };
        cells.extend([
            right(least),
            right(count),
            right(counters(&device.outputs)),
            right(counters(&device.inputs)),
            right(rate),
            Cell::from(told).style(bad(is_told)),
        ]);
    } else {
        let told = match (behind, device.alarms.len()) {
            (Some(behind), _) => words::span(behind.for_ns),
            (None, 0) => "-".to_owned(),
            (None, count) => format!("{count} up"),
        };
        cells.push(Cell::from(told).style(bad(is_told)));
    }
    cells
}

/// A figure, aligned to the right.
fn right(text: String) -> Cell<'static> {
    Cell::from(Line::from(text).right_aligned())
}

/// Counters such as `       0  0  0  0`, below the sub-indices in the head.
fn counters(all: &[isocat_engine::status::Counter; SUBS.len()]) -> String {
    let mut text = " ".repeat(6);
    for counter in all {
        let value = counter.value.map_or("-".to_owned(), |value| value.to_string());
        text += &format!(" {value:>2}");
    }
    text
}

/// A mode in at most eight characters.
pub(super) fn short(mode: &str) -> &str {
    match mode {
        "dc-shift-sync1" => "dc-shift",
        "dc-subordinated" => "dc-sub",
        "free-run" => "free-run",
        mode => mode,
    }
}

fn draw_log(frame: &mut Frame<'_>, area: Rect, view: &View) {
    if area.height == 0 {
        return;
    }
    let look = Look(view.colour);
    let width = usize::from(area.width);
    let room = usize::from(area.height) - 1;
    let all = view.trend().events();
    let skip = all.len().saturating_sub(room);
    let title = format!("{:─<width$}", "─ what happened ");
    let mut lines = vec![Line::styled(title, look.quiet())];
    lines.extend(all.skip(skip).map(|event| {
        let style = if event.bad { look.bad() } else { Style::new() };
        Line::styled(words::cut(&told(event, view), width), style)
    }));
    frame.render_widget(Paragraph::new(lines), area);
}

/// An event such as `  12.345 s  2 axis 3: SAFEOP+ERR, 0x001A …`.
fn told(event: &Event, view: &View) -> String {
    let place = view.trend().status().map(|status| words::of(status, event));
    format!("{:>12}  {}{}", words::seconds(event.at_ns), place.unwrap_or_default(), event.what)
}

fn draw_keys(frame: &mut Frame<'_>, area: Rect, view: &View) {
    let (sort, reverse) = view.sort();
    let way = if reverse { ", reversed" } else { "" };
    let text = match view.page() {
        Page::Cycle => "Esc back  ↑↓ other device  p pause  ? help  q quit".to_owned(),
        _ => format!(
            "q quit  ↑↓ select  Enter cycle  s sort: {}{way}  r reverse  p pause  ? help",
            sort.name()
        ),
    };
    let line = Line::styled(words::cut(&text, usize::from(area.width)), Look(view.colour).quiet());
    frame.render_widget(Paragraph::new(line), area);
}

fn draw_help(frame: &mut Frame<'_>, area: Rect, view: &View) {
    let lines: Vec<Line<'_>> = HELP.lines().map(Line::raw).collect();
    let height = (lines.len() as u16 + 2).min(area.height);
    let width = 76.min(area.width);
    let place = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    frame.render_widget(Clear, place);
    let block = ratatui::widgets::Block::bordered().title(" isocat watch ");
    let help = Paragraph::new(lines).block(block).wrap(Wrap { trim: false });
    frame
        .render_widget(help.style(Look(view.colour).quiet().remove_modifier(Modifier::DIM)), place);
}

const HELP: &str = "\
q, Ctrl-C     quit                 arrows, j k    select a SubDevice
s             sort by the next     PgUp PgDn      ten up, down
r             reverse the order    Home End       first, last
Enter         its cycle            Esc            back
p, space      pause the display    ?              this; any key ends it

error   SYNC0 edges off the grid [t], or 0x092C [r] on a wire: now, worst
margin  what is left before SYNC0 when outputs are ready: least of late
ppm     its oscillator against the reference's, by 0x0930 and 0x0932
counts  how much entries 0B 0C 0D 20 of 0x1C32 and 0x1C33 have risen
alarm   alarms that are up, or how long it has been behind the others' state
[t] true time  [r] register or object  [m] MainDevice";
