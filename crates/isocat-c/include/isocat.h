/*
 * isocat: a virtual EtherCAT segment in deterministic virtual time.
 *
 * Made of crates/isocat-c by its test `header`; docs/c.md tells how it is used.
 *
 * - The library has no thread, no clock and no state of its own: the same calls give the same answers, to the byte.
 * - Functions that can fail give an isocat_code, and take a place for an error last: NULL, or a pointer that they set if the code is
 *   below 0, and leave alone if not. The caller frees the error.
 * - Handles are made by functions with a pointer to a pointer, and freed by isocat_..._free. A plan and a verdict may be read by several
 *   threads at a time; a segment or a bus is for one thread at a time, whichever that is: a second one gets ISOCAT_BUSY.
 * - Pointers are NULL or valid. NULL is refused with ISOCAT_NULL_ARGUMENT, where it is not said to be allowed. Where a length is 0, the
 *   bytes may be NULL.
 * - Structs begin with their size: set it before a call. So programs and libraries of different ages understand each other.
 * - Instants and times are ns. Texts are UTF-8 and end with a zero. `const char *` belongs to the library, `char *` to the caller.
 * - Positions of SubDevices count from 0 in processing order.
 */

#ifndef ISOCAT_H
#define ISOCAT_H

#include <stddef.h>
#include <stdint.h>

/**
 * What read_object and write_object answer for an object that the application does not have: the
 * SubDevice's own store has it.
 */
#define ISOCAT_NOT_MINE 4294967295

/**
 * For isocat_bus_receive: whichever port the answer comes to.
 */
#define ISOCAT_ANY_PORT 4294967295

/**
 * The longest frame, bytes from the destination address on, without check sequence.
 */
#define ISOCAT_LONGEST_FRAME 1514

/**
 * The interface of this header: it is raised when programs can't be linked with a newer library
 * any more.
 */
#define ISOCAT_ABI_VERSION 0

/**
 * Nothing speaks against any SubDevice in operation.
 */
#define ISOCAT_IN_SYNC 0

/**
 * Something speaks against one.
 */
#define ISOCAT_NOT_IN_SYNC 1

/**
 * No SubDevice came to operation, so there is nothing to judge.
 */
#define ISOCAT_NOT_KNOWN 3

/**
 * All that the segment file expects came so, or it expects nothing.
 */
#define ISOCAT_AS_EXPECTED 0

/**
 * Something did not come so.
 */
#define ISOCAT_NOT_AS_EXPECTED 1

/**
 * All that was judged came so, and something could not be judged.
 */
#define ISOCAT_NOT_JUDGED 3

/**
 * How a call ended: below 0 nothing happened but that an error was made.
 */
enum isocat_code
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * It is done.
     */
    ISOCAT_OK = 0,
    /**
     * Nothing is wrong, and there is nothing to give: no answer has come by now, no outputs act.
     */
    ISOCAT_NOTHING = 1,
    /**
     * A pointer is NULL that may not be.
     */
    ISOCAT_NULL_ARGUMENT = -1,
    /**
     * A text is not UTF-8.
     */
    ISOCAT_NOT_UTF8 = -2,
    /**
     * A length, a position or a port that does not exist.
     */
    ISOCAT_OUT_OF_RANGE = -3,
    /**
     * The caller's buffer is too small. What is in it stays as it was.
     */
    ISOCAT_TOO_SMALL = -4,
    /**
     * An instant that has passed, or is too far ahead.
     */
    ISOCAT_TIME = -5,
    /**
     * A file, a text or a fault is wrong; or a segment can't be planned.
     */
    ISOCAT_BAD_INPUT = -6,
    /**
     * The handle is in use: the call comes out of a callback, or from a second thread.
     */
    ISOCAT_BUSY = -7,
    /**
     * The size of a struct was not set.
     */
    ISOCAT_STRUCT_SIZE = -8,
    /**
     * A fault of this library. A bus or segment on which it happened is of no use any more, but to
     * be freed.
     */
    ISOCAT_PANIC = -9,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum isocat_code isocat_code;
#else
typedef int32_t isocat_code;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * A segment in virtual time.
 *
 * Instants are ns of the caller's clock. The bus has a present, which moves when the caller says
 * so: by isocat_bus_advance, and by isocat_bus_send to the instant of the frame. It never goes
 * back, moves by an hour at once at most, and by 30 days in all.
 */
typedef struct isocat_bus isocat_bus;

/**
 * An error: made by a call that failed, freed by isocat_error_free.
 */
typedef struct isocat_error isocat_error;

/**
 * A plan: each demand on the cycle as a line, and the phases.
 */
typedef struct isocat_plan isocat_plan;

/**
 * A segment: which SubDevices stand on the wire, and how they are set up. Buses and plans are made
 * of it, and do not need it afterwards.
 */
typedef struct isocat_segment isocat_segment;

/**
 * What a bus comes to, as of the instant at which it was asked for. It does not need its bus.
 */
typedef struct isocat_verdict isocat_verdict;

/**
 * What becomes of a frame that was sent.
 */
typedef struct isocat_sent {
    /**
     * sizeof(isocat_sent).
     */
    size_t size;
    /**
     * When the last bit of its answer is back at the port, ns; 0 if it is lost.
     */
    uint64_t back_ns;
    /**
     * 1 if an answer comes back; 0 if it is lost, in the segment or by a fault.
     */
    int32_t comes_back;
    /**
     * The port to which the answer comes: in a whole ring the other one.
     */
    uint32_t port;
} isocat_sent;

/**
 * An answer that is back.
 */
typedef struct isocat_arrival {
    /**
     * sizeof(isocat_arrival).
     */
    size_t size;
    /**
     * When its last bit came back, ns.
     */
    uint64_t at_ns;
    /**
     * Its bytes, from the destination address on, without check sequence.
     */
    size_t length;
    /**
     * The port to which it came.
     */
    uint32_t port;
    /**
     * Always 0.
     */
    uint32_t reserved;
} isocat_arrival;

/**
 * The state of a SubDevice.
 */
typedef struct isocat_device_state {
    /**
     * sizeof(isocat_device_state).
     */
    size_t size;
    /**
     * 1 INIT, 2 PREOP, 3 BOOT, 4 SAFEOP, 8 OP.
     */
    uint32_t state;
    /**
     * AL status code (0x0134): why it is there, if it was not asked to; else 0.
     */
    uint32_t status_code;
} isocat_device_state;

/**
 * A plan as a whole. Phases count from the frame at the reference clock.
 */
typedef struct isocat_plan_summary {
    /**
     * sizeof(isocat_plan_summary).
     */
    size_t size;
    /**
     * Its lines.
     */
    size_t lines;
    /**
     * Its SubDevices.
     */
    size_t devices;
    /**
     * Bus cycle, ns.
     */
    int64_t cycle_ns;
    /**
     * Phase of the frame in the system-time cycle, ns.
     */
    int64_t send_phase_ns;
    /**
     * Phase of the pulse at which outputs act, the same for all SubDevices with SYNC, ns; 0
     * without.
     */
    int64_t acting_phase_ns;
    /**
     * Least slack of all lines of the cycle, ns; negative: it does not fit.
     */
    int64_t least_slack_ns;
    /**
     * 1 if every line has slack of 0 or more.
     */
    int32_t fits;
    /**
     * 1 if a SubDevice has SYNC.
     */
    int32_t has_acting_phase;
} isocat_plan_summary;

/**
 * A demand on the cycle.
 */
typedef struct isocat_plan_line {
    /**
     * sizeof(isocat_plan_line).
     */
    size_t size;
    /**
     * Its short name, such as "outputs-before-sync0". It lives as long as the plan.
     */
    const char *check;
    /**
     * The formula in words. It lives as long as the plan.
     */
    const char *demand;
    /**
     * Time needed, ns.
     */
    int64_t needed_ns;
    /**
     * Time there is, ns.
     */
    int64_t available_ns;
    /**
     * What is left, ns; negative: it does not fit.
     */
    int64_t slack_ns;
    /**
     * Position of the SubDevice whose line it is; -1: of the frames.
     */
    int64_t position;
} isocat_plan_line;

/**
 * What a plan has for a SubDevice.
 */
typedef struct isocat_plan_device {
    /**
     * sizeof(isocat_plan_device).
     */
    size_t size;
    /**
     * Its mode, such as "dc-sync0". It lives as long as the plan.
     */
    const char *mode;
    /**
     * Propagation delay from the reference clock, ns.
     */
    int64_t delay_ns;
    /**
     * Cycle of SYNC0 (0x09A0), ns; 0 without.
     */
    int64_t sync0_cycle_ns;
    /**
     * Phase of SYNC0 behind the frame at the reference clock, ns: what SOEM's ecx_dcsync0 takes as
     * CyclShift where frames reach the reference clock at 0 of the cycle. 0 without.
     */
    int64_t sync0_phase_ns;
    /**
     * From SYNC0 to SYNC1 (0x09A4), ns; 0 without.
     */
    int64_t sync1_ns;
    /**
     * 1 if SYNC0 is to be set up for it.
     */
    int32_t uses_sync0;
    /**
     * 1 if SYNC1 is, too.
     */
    int32_t uses_sync1;
} isocat_plan_device;

/**
 * The application of a SubDevice. Every function may be NULL: then nothing is done in that step.
 * Set all of it to 0, then `size`.
 *
 * Functions are called out of the calls of a bus (send, advance, and whatever looks at
 * SubDevices), on the thread that made the call, one at a time, in the order of virtual time. They
 * must return: no longjmp, no exceptions. Calls on the same bus are refused meanwhile
 * (ISOCAT_BUSY). Memory that they are given is theirs until they return.
 */
typedef struct isocat_application {
    /**
     * sizeof(isocat_application).
     */
    size_t size;
    /**
     * What each function gets as its first argument; the library does not look behind it.
     */
    void *user;
    /**
     * Outputs have come: the process image from the MainDevice. In OP only.
     */
    void (*map_outputs)(void *user, const uint8_t *outputs, size_t length);
    /**
     * The application's own work, called once in each cycle. `cycle_ns` is the cycle in ns, and 0
     * where it is not known.
     */
    void (*work)(void *user, int64_t cycle_ns);
    /**
     * Outputs act on the process from now on.
     */
    void (*outputs_valid)(void *user);
    /**
     * Inputs are to be taken from the process now.
     */
    void (*latch_inputs)(void *user);
    /**
     * Inputs are to be put into the process image to the MainDevice. Bytes that are left alone
     * stay as they were.
     */
    void (*map_inputs)(void *user, uint8_t *inputs, size_t length);
    /**
     * OP was left: outputs go to their safe state.
     */
    void (*safe_outputs)(void *user);
    /**
     * The SubDevice lost its power. When it comes back, it starts from INIT.
     */
    void (*power_off)(void *user);
    /**
     * An object is read: its value goes into `value`, which has room for `capacity` bytes, and its
     * length into `length`. Gives 0, an SDO abort code, or ISOCAT_NOT_MINE.
     */
    uint32_t (*read_object)(void *user,
                            uint16_t index,
                            uint8_t sub,
                            uint8_t *value,
                            size_t capacity,
                            size_t *length);
    /**
     * An object was written. Gives 0 or ISOCAT_NOT_MINE where the value may be stored, or an SDO
     * abort code.
     */
    uint32_t (*write_object)(void *user,
                             uint16_t index,
                             uint8_t sub,
                             const uint8_t *value,
                             size_t length);
} isocat_application;

/**
 * A verdict as a whole.
 */
typedef struct isocat_verdict_summary {
    /**
     * sizeof(isocat_verdict_summary).
     */
    size_t size;
    /**
     * Frames that were sent.
     */
    uint64_t frames;
    /**
     * Those that came back.
     */
    uint64_t answered;
    /**
     * Those that were lost, in the segment or by a fault.
     */
    uint64_t lost;
    /**
     * Answers that were lost since more than 8192 were not received.
     */
    uint64_t overrun;
    /**
     * MainDevices, one after the other: a new one begins where addresses are given anew, or after
     * a long silence.
     */
    size_t sessions;
    /**
     * SubDevices that the last one had in OP when the judging began last.
     */
    size_t in_op;
    /**
     * How long the last one was judged since then, ns.
     */
    int64_t judged_ns;
    /**
     * ISOCAT_NOT_IN_SYNC if something speaks against any session; else that of the last one:
     * ISOCAT_IN_SYNC or ISOCAT_NOT_KNOWN.
     */
    int32_t answer;
    /**
     * What became of the segment file's [[expect]] tables: ISOCAT_AS_EXPECTED,
     * ISOCAT_NOT_AS_EXPECTED or ISOCAT_NOT_JUDGED.
     */
    int32_t expected;
} isocat_verdict_summary;

/**
 * What is said of a SubDevice, since the judging began last. Times are true time, ns.
 */
typedef struct isocat_device_verdict {
    /**
     * sizeof(isocat_device_verdict).
     */
    size_t size;
    /**
     * Its name. This and the other texts live as long as the verdict.
     */
    const char *name;
    /**
     * Its state, such as "OP".
     */
    const char *state;
    /**
     * The mode that it runs in, whatever was asked for, such as "dc-sync0".
     */
    const char *mode;
    /**
     * SYNC0 edges that were measured. 0: the next two are 0, too.
     */
    uint64_t sync0_edges;
    /**
     * Mean of SYNC0's error, against the grid that the MainDevice wrote.
     */
    double sync0_mean_ns;
    /**
     * Its worst error, without the sign.
     */
    double sync0_worst_ns;
    /**
     * Cycles of which the margin is known. 0: the next is 0, too.
     */
    uint64_t margins;
    /**
     * Least time from the end of copying and calculating to SYNC0.
     */
    double least_margin_ns;
    /**
     * 0x1C32:0B.
     */
    uint32_t sm_event_missed;
    /**
     * 0x1C32:0C.
     */
    uint32_t cycle_time_too_small;
    /**
     * 0x1C32:0D.
     */
    uint32_t shift_time_too_short;
    /**
     * 0x1C32:20.
     */
    uint32_t sync_error;
    /**
     * What speaks against it: isocat_verdict_finding has the words.
     */
    size_t findings;
} isocat_device_verdict;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Makes a bus of a segment: all SubDevices that are there from the start are switched on at
 * `now_ns`.
 *
 * `now_ns`: the present on the caller's clock, ns from whatever instant; 2^63 - 1 less 30 days at
 * most.
 * `bus`: where the handle goes; freed by isocat_bus_free.
 */
isocat_code isocat_bus_new(const struct isocat_segment *segment,
                           uint64_t now_ns,
                           struct isocat_bus **bus,
                           struct isocat_error **error);

/**
 * Frees a bus. NULL is nothing to free. While it is in use, as by the call that a callback comes
 * from, nothing is done.
 */
void isocat_bus_free(struct isocat_bus *bus);

/**
 * The present of a bus, ns.
 */
isocat_code isocat_bus_now(const struct isocat_bus *bus,
                           uint64_t *now_ns,
                           struct isocat_error **error);

/**
 * Sends a frame at the instant `at_ns`, to which time goes on; it waits for the frame before it to
 * have left. The answer, if one comes back, is handed out by isocat_bus_receive.
 *
 * `port`: 0, or 1 for the other end of a ring.
 * `frame`: is copied: 14 to ISOCAT_LONGEST_FRAME bytes from the destination address on, without
 * check sequence. On the wire a short one takes as long as one of 60.
 * `sent`: what becomes of it; may be NULL.
 */
isocat_code isocat_bus_send(struct isocat_bus *bus,
                            uint32_t port,
                            uint64_t at_ns,
                            const uint8_t *frame,
                            size_t length,
                            struct isocat_sent *sent,
                            struct isocat_error **error);

/**
 * When the next answer is back, ns: at whichever port, and in the past where one has not been
 * received yet. ISOCAT_NOTHING if none is under way.
 */
isocat_code isocat_bus_next_arrival(const struct isocat_bus *bus,
                                    uint64_t *at_ns,
                                    struct isocat_error **error);

/**
 * Takes the next answer that is back by now: those of frames, and their copies where a fault
 * doubled them. ISOCAT_NOTHING if there is none. Time does not move.
 *
 * `port`: 0, 1, or ISOCAT_ANY_PORT.
 * `buffer`: room for `capacity` bytes. ISOCAT_TOO_SMALL: the answer stays, and `arrival` says how
 * long it is.
 * `arrival`: what came; `size` has to be set.
 */
isocat_code isocat_bus_receive(struct isocat_bus *bus,
                               uint32_t port,
                               uint8_t *buffer,
                               size_t capacity,
                               struct isocat_arrival *arrival,
                               struct isocat_error **error);

/**
 * Time goes on to `to_ns`: SubDevices do what they do by themselves. To the present is allowed,
 * and does nothing.
 */
isocat_code isocat_bus_advance(struct isocat_bus *bus, uint64_t to_ns, struct isocat_error **error);

/**
 * When the bus looks at its SubDevices by itself the next time, ns: for programs that want to know
 * when something may happen. isocat_bus_advance needs no help: it looks at all such instants on
 * its way. ISOCAT_NOTHING if nothing will ever happen by itself.
 */
isocat_code isocat_bus_next_timeout(const struct isocat_bus *bus,
                                    uint64_t *at_ns,
                                    struct isocat_error **error);

/**
 * The link at a port of the MainDevice goes away now (`up` is 0), or comes.
 */
isocat_code isocat_bus_link(struct isocat_bus *bus,
                            uint32_t port,
                            int32_t up,
                            struct isocat_error **error);

/**
 * Lets something go wrong now.
 *
 * `fault`: a line as of `isocat control` and of `[[fault]]` tables (docs/faults.md), such as
 * "drop 3", "pull axis 2 for 500ms", "power-cycle 1", "misbehave 1 dead-sync0", "heal". Those of
 * the host (stall, late-wake-ups, slow-send, clock of the host) are refused: the caller is the
 * host.
 */
isocat_code isocat_bus_fault(struct isocat_bus *bus,
                             const char *fault,
                             struct isocat_error **error);

/**
 * Plans that something goes wrong at the instant `at_ns`, now or later.
 */
isocat_code isocat_bus_fault_at(struct isocat_bus *bus,
                                uint64_t at_ns,
                                const char *fault,
                                struct isocat_error **error);

/**
 * The MainDevice is done: its session ends as of its last frame. Frames that come all the same
 * begin another session.
 */
isocat_code isocat_bus_finish(struct isocat_bus *bus, struct isocat_error **error);

/**
 * The state of a SubDevice as of now.
 *
 * `state`: where it goes; `size` has to be set.
 */
isocat_code isocat_device_get_state(struct isocat_bus *bus,
                                    size_t position,
                                    struct isocat_device_state *state,
                                    struct isocat_error **error);

/**
 * The outputs of a SubDevice as it took them last. ISOCAT_NOTHING while they are in their safe
 * state.
 *
 * `buffer`: room for `capacity` bytes.
 * `length`: how many bytes there are; with ISOCAT_TOO_SMALL, how many there would be.
 */
isocat_code isocat_device_outputs(struct isocat_bus *bus,
                                  size_t position,
                                  uint8_t *buffer,
                                  size_t capacity,
                                  size_t *length,
                                  struct isocat_error **error);

/**
 * Sets the inputs of a SubDevice: they are on the wire when it has mapped its inputs the next
 * time, and stay until they are set again. Bytes of the process image beyond `length` stay its
 * application's.
 *
 * `inputs`: is copied; not more bytes than the SubDevice can have.
 */
isocat_code isocat_device_set_inputs(struct isocat_bus *bus,
                                     size_t position,
                                     const uint8_t *inputs,
                                     size_t length,
                                     struct isocat_error **error);

/**
 * Gives the inputs of a SubDevice back to its application.
 */
isocat_code isocat_device_release_inputs(struct isocat_bus *bus,
                                         size_t position,
                                         struct isocat_error **error);

/**
 * The code of an error; ISOCAT_OK for NULL.
 */
isocat_code isocat_error_code(const struct isocat_error *error);

/**
 * What is wrong, in words: the place, what was found and what was expected. One line, or two where
 * there is a hint. It lives as long as the error; NULL for NULL.
 */
const char *isocat_error_text(const struct isocat_error *error);

/**
 * The file in which it is wrong, as it was named; empty where no file is wrong. It lives as long
 * as the error; NULL for NULL.
 */
const char *isocat_error_file(const struct isocat_error *error);

/**
 * The line of that file, from 1; 0 where no line is wrong, and for NULL.
 */
uint32_t isocat_error_line(const struct isocat_error *error);

/**
 * The column in characters, from 1; 0 where no line is wrong, and for NULL.
 */
uint32_t isocat_error_column(const struct isocat_error *error);

/**
 * Frees an error. NULL is nothing to free.
 */
void isocat_error_free(struct isocat_error *error);

/**
 * Frees a text that the caller owns: one that a function gave through a `char **`. NULL is nothing
 * to free.
 */
void isocat_text_free(char *text);

/**
 * Plans a segment as it is described; nothing is sent. Lines that do not fit are no error.
 *
 * `plan`: where the handle goes; freed by isocat_plan_free.
 */
isocat_code isocat_plan_new(const struct isocat_segment *segment,
                            struct isocat_plan **plan,
                            struct isocat_error **error);

/**
 * The plan as a whole.
 *
 * `summary`: where it goes; `size` has to be set.
 */
isocat_code isocat_plan_get_summary(const struct isocat_plan *plan,
                                    struct isocat_plan_summary *summary,
                                    struct isocat_error **error);

/**
 * A line of the plan.
 *
 * `number`: from 0.
 * `line`: where it goes; `size` has to be set.
 */
isocat_code isocat_plan_get_line(const struct isocat_plan *plan,
                                 size_t number,
                                 struct isocat_plan_line *line,
                                 struct isocat_error **error);

/**
 * What the plan has for a SubDevice.
 *
 * `device`: where it goes; `size` has to be set.
 */
isocat_code isocat_plan_get_device(const struct isocat_plan *plan,
                                   size_t position,
                                   struct isocat_plan_device *device,
                                   struct isocat_error **error);

/**
 * The plan as a JSON document (docs/plan.schema.json).
 *
 * `json`: where the text goes; the caller owns it, and frees it by isocat_text_free.
 */
isocat_code isocat_plan_json(const struct isocat_plan *plan,
                             char **json,
                             struct isocat_error **error);

/**
 * Frees a plan. NULL is nothing to free.
 */
void isocat_plan_free(struct isocat_plan *plan);

/**
 * ISOCAT_ABI_VERSION of the library that runs. A program compares it with that of its header.
 */
uint32_t isocat_abi_version(void);

/**
 * The version of the library, such as "0.1.0". It lives for ever.
 */
const char *isocat_version(void);

/**
 * Gives the built-in segment: two drives, a coupler with a terminal, and a third drive, at 1 ms.
 *
 * `segment`: where the handle goes; freed by isocat_segment_free.
 */
isocat_code isocat_segment_built_in(struct isocat_segment **segment, struct isocat_error **error);

/**
 * Reads a segment file (TOML, docs/segment-file.md), 16 MiB at most, and the files that it names.
 *
 * `path`: UTF-8. Files that it names are looked for beside it.
 * `segment`: where the handle goes; freed by isocat_segment_free.
 */
isocat_code isocat_segment_read(const char *path,
                                struct isocat_segment **segment,
                                struct isocat_error **error);

/**
 * Reads the same from memory.
 *
 * `text`: `length` bytes of UTF-8, 16 MiB at most; no zero needs to end them.
 * `path`: what errors call it, and beside which the files lie that it names. NULL: it is called
 * "segment", and they are looked for in the working directory.
 */
isocat_code isocat_segment_parse(const uint8_t *text,
                                 size_t length,
                                 const char *path,
                                 struct isocat_segment **segment,
                                 struct isocat_error **error);

/**
 * How many SubDevices it has; 0 for NULL. Positions count from 0, in processing order.
 */
size_t isocat_segment_devices(const struct isocat_segment *segment);

/**
 * The name of a SubDevice in UTF-8; NULL where there is none. It lives as long as the segment.
 */
const char *isocat_segment_device_name(const struct isocat_segment *segment, size_t position);

/**
 * The bus cycle that it is described with, ns; 0 for NULL.
 */
int64_t isocat_segment_cycle_ns(const struct isocat_segment *segment);

/**
 * How many ports of a MainDevice it hangs on: 1, or 2 for a ring; 0 for NULL.
 */
uint32_t isocat_segment_ports(const struct isocat_segment *segment);

/**
 * Sets the seed of everything random, for buses that are made from now on. Without it, that of the
 * file.
 */
isocat_code isocat_segment_set_seed(struct isocat_segment *segment,
                                    uint64_t seed,
                                    struct isocat_error **error);

/**
 * Gives a SubDevice an application of the caller's own, in buses that are made from now on. Its
 * process data, objects and times stay those of its profile. A second call for the same SubDevice
 * replaces the first one.
 *
 * `application`: is copied; `size` has to be set. What `user` points to has to live as long as the
 * buses.
 */
isocat_code isocat_segment_plug_in(struct isocat_segment *segment,
                                   size_t position,
                                   const struct isocat_application *application,
                                   struct isocat_error **error);

/**
 * Frees a segment. NULL is nothing to free.
 */
void isocat_segment_free(struct isocat_segment *segment);

/**
 * The verdict as of now. The bus goes on; at the end, isocat_bus_finish comes before.
 *
 * `verdict`: where the handle goes; freed by isocat_verdict_free.
 */
isocat_code isocat_bus_verdict(struct isocat_bus *bus,
                               struct isocat_verdict **verdict,
                               struct isocat_error **error);

/**
 * The verdict as a whole.
 *
 * `summary`: where it goes; `size` has to be set.
 */
isocat_code isocat_verdict_get_summary(const struct isocat_verdict *verdict,
                                       struct isocat_verdict_summary *summary,
                                       struct isocat_error **error);

/**
 * What is said of a SubDevice, in the last session. ISOCAT_OUT_OF_RANGE if nothing is: no
 * SubDevice came to operation there.
 *
 * `device`: where it goes; `size` has to be set.
 */
isocat_code isocat_verdict_get_device(const struct isocat_verdict *verdict,
                                      size_t position,
                                      struct isocat_device_verdict *device,
                                      struct isocat_error **error);

/**
 * What speaks against a SubDevice, as a sentence; NULL where there is nothing more. It lives as
 * long as the verdict.
 *
 * `number`: from 0 to isocat_device_verdict.findings - 1.
 */
const char *isocat_verdict_finding(const struct isocat_verdict *verdict,
                                   size_t position,
                                   size_t number);

/**
 * All of it in words, as `isocat serve` tells it: what the MainDevice did, what it left out, and
 * the verdict. Many lines.
 *
 * `text`: where it goes; the caller owns it, and frees it by isocat_text_free.
 */
isocat_code isocat_verdict_text(const struct isocat_verdict *verdict,
                                char **text,
                                struct isocat_error **error);

/**
 * All of it as a JSON document (docs/serve-summary.schema.json).
 *
 * `json`: where the text goes; the caller owns it, and frees it by isocat_text_free.
 */
isocat_code isocat_verdict_json(const struct isocat_verdict *verdict,
                                char **json,
                                struct isocat_error **error);

/**
 * Frees a verdict. NULL is nothing to free.
 */
void isocat_verdict_free(struct isocat_verdict *verdict);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* ISOCAT_H */
