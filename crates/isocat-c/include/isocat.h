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
 * Returned by read_object and write_object for an object that the application does not have: then
 * the SubDevice's own store handles it.
 */
#define ISOCAT_NOT_MINE 4294967295

/**
 * For isocat_bus_receive: an answer at any port.
 */
#define ISOCAT_ANY_PORT 4294967295

/**
 * Length of the longest frame, bytes, from the destination address on, without check sequence.
 */
#define ISOCAT_LONGEST_FRAME 1514

/**
 * The version of this interface. It is raised when programs can no longer be linked with a newer
 * library.
 */
#define ISOCAT_ABI_VERSION 0

/**
 * There is no finding against any SubDevice in operation.
 */
#define ISOCAT_IN_SYNC 0

/**
 * There is a finding against a SubDevice in operation.
 */
#define ISOCAT_NOT_IN_SYNC 1

/**
 * No SubDevice reached operation, so nothing was judged.
 */
#define ISOCAT_NOT_KNOWN 3

/**
 * Everything that the segment file expects came true, or it expects nothing.
 */
#define ISOCAT_AS_EXPECTED 0

/**
 * Something that the segment file expects did not come true.
 */
#define ISOCAT_NOT_AS_EXPECTED 1

/**
 * All that was judged came true, but something could not be judged.
 */
#define ISOCAT_NOT_JUDGED 3

/**
 * The result of a call. A code below 0 means that nothing was done, except that an error was made.
 */
enum isocat_code
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    /**
     * The call succeeded.
     */
    ISOCAT_OK = 0,
    /**
     * No error, but there is no result: no answer has come back, or no outputs act.
     */
    ISOCAT_NOTHING = 1,
    /**
     * A pointer is NULL that must not be.
     */
    ISOCAT_NULL_ARGUMENT = -1,
    /**
     * A text is not UTF-8.
     */
    ISOCAT_NOT_UTF8 = -2,
    /**
     * A length, a position or a port does not exist.
     */
    ISOCAT_OUT_OF_RANGE = -3,
    /**
     * The caller's buffer is too small. Its content is unchanged.
     */
    ISOCAT_TOO_SMALL = -4,
    /**
     * An instant has passed, or is too far ahead.
     */
    ISOCAT_TIME = -5,
    /**
     * A file, a text or a fault is wrong, or a segment can't be planned.
     */
    ISOCAT_BAD_INPUT = -6,
    /**
     * The handle is in use: the call comes from a callback or from a second thread.
     */
    ISOCAT_BUSY = -7,
    /**
     * The size of a struct was not set.
     */
    ISOCAT_STRUCT_SIZE = -8,
    /**
     * A bug of this library. A bus or segment on which it happened can only be freed.
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
 * Instants are ns of the caller's clock. The bus has a present, which only the caller advances: by
 * isocat_bus_advance, and by isocat_bus_send to the instant of the frame. It never goes back, and
 * advances by at most an hour at once and 30 days in total.
 */
typedef struct isocat_bus isocat_bus;

/**
 * An error, which is made by a call that failed and freed by isocat_error_free.
 */
typedef struct isocat_error isocat_error;

/**
 * A plan: each demand on the cycle as a line, and the phases.
 */
typedef struct isocat_plan isocat_plan;

/**
 * A segment: the SubDevices on the wire and their set-up. Buses and plans are made from it, and do
 * not need it afterwards.
 */
typedef struct isocat_segment isocat_segment;

/**
 * The verdict on a bus at the instant at which it was requested. It does not need its bus.
 */
typedef struct isocat_verdict isocat_verdict;

/**
 * The fate of a frame that was sent.
 */
typedef struct isocat_sent {
    /**
     * sizeof(isocat_sent).
     */
    size_t size;
    /**
     * When the last bit of its answer is back at the port, ns; 0 if the answer is lost.
     */
    uint64_t back_ns;
    /**
     * 1 if an answer comes back; 0 if it is lost, in the segment or by a fault.
     */
    int32_t comes_back;
    /**
     * The port at which the answer arrives: in an unbroken ring, the other one.
     */
    uint32_t port;
} isocat_sent;

/**
 * An answer that has come back.
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
     * Its length in bytes, from the destination address on, without check sequence.
     */
    size_t length;
    /**
     * The port at which it arrived.
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
     * AL status code (0x0134): the reason of a state that was not requested; else 0.
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
     * Number of its lines.
     */
    size_t lines;
    /**
     * Number of its SubDevices.
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
     * without SYNC.
     */
    int64_t acting_phase_ns;
    /**
     * Least slack of all lines, ns; negative: the cycle does not fit.
     */
    int64_t least_slack_ns;
    /**
     * 1 if every line has slack of 0 or more.
     */
    int32_t fits;
    /**
     * 1 if any SubDevice has SYNC.
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
     * Its short name, for example "outputs-before-sync0". Valid as long as the plan.
     */
    const char *check;
    /**
     * The formula in words. Valid as long as the plan.
     */
    const char *demand;
    /**
     * Time needed, ns.
     */
    int64_t needed_ns;
    /**
     * Available time, ns.
     */
    int64_t available_ns;
    /**
     * Slack, ns; negative: the demand does not fit.
     */
    int64_t slack_ns;
    /**
     * Position of the SubDevice that the line belongs to; -1: the frames.
     */
    int64_t position;
} isocat_plan_line;

/**
 * The part of a plan for a SubDevice.
 */
typedef struct isocat_plan_device {
    /**
     * sizeof(isocat_plan_device).
     */
    size_t size;
    /**
     * Its mode, for example "dc-sync0". Valid as long as the plan.
     */
    const char *mode;
    /**
     * Propagation delay from the reference clock, ns.
     */
    int64_t delay_ns;
    /**
     * Cycle of SYNC0 (0x09A0), ns; 0 without SYNC0.
     */
    int64_t sync0_cycle_ns;
    /**
     * Phase of SYNC0 after the frame at the reference clock, ns. It is CyclShift of SOEM's
     * ecx_dcsync0 if frames reach the reference clock at 0 of the cycle. 0 without SYNC0.
     */
    int64_t sync0_phase_ns;
    /**
     * Time from SYNC0 to SYNC1 (0x09A4), ns; 0 without SYNC1.
     */
    int64_t sync1_ns;
    /**
     * 1 if SYNC0 is to be set up for it.
     */
    int32_t uses_sync0;
    /**
     * 1 if SYNC1 is to be set up for it, too.
     */
    int32_t uses_sync1;
} isocat_plan_device;

/**
 * The application of a SubDevice. Each function may be NULL: then that step does nothing. Set the
 * whole struct to 0, then `size`.
 *
 * Functions are called from calls on a bus (send, advance, and those that read SubDevices), on the
 * calling thread, one at a time, in the order of virtual time. They must return: no longjmp, no
 * exceptions. Meanwhile calls on the same bus are refused (ISOCAT_BUSY). Memory passed to a
 * function is valid until the function returns.
 */
typedef struct isocat_application {
    /**
     * sizeof(isocat_application).
     */
    size_t size;
    /**
     * The first argument of each function; the library does not read what it points to.
     */
    void *user;
    /**
     * New outputs of the MainDevice, as process image. Only called in OP.
     */
    void (*map_outputs)(void *user, const uint8_t *outputs, size_t length);
    /**
     * The application's own work, called once in each cycle. `cycle_ns` is the cycle in ns, or 0
     * if it is not known.
     */
    void (*work)(void *user, int64_t cycle_ns);
    /**
     * Outputs act on the process from now on.
     */
    void (*outputs_valid)(void *user);
    /**
     * Takes the inputs from the process now.
     */
    void (*latch_inputs)(void *user);
    /**
     * Writes the inputs into the process image to the MainDevice. Bytes that are not written keep
     * their values.
     */
    void (*map_inputs)(void *user, uint8_t *inputs, size_t length);
    /**
     * OP was left: outputs take their safe state.
     */
    void (*safe_outputs)(void *user);
    /**
     * The SubDevice lost its power. When it comes back, it starts from INIT.
     */
    void (*power_off)(void *user);
    /**
     * An object is read. Writes its value to `value`, which holds up to `capacity` bytes, and its
     * length to `length`. Returns 0, an SDO abort code, or ISOCAT_NOT_MINE.
     */
    uint32_t (*read_object)(void *user,
                            uint16_t index,
                            uint8_t sub,
                            uint8_t *value,
                            size_t capacity,
                            size_t *length);
    /**
     * An object was written. Returns 0 or ISOCAT_NOT_MINE if the value may be stored, or an SDO
     * abort code.
     */
    uint32_t (*write_object)(void *user,
                             uint16_t index,
                             uint8_t sub,
                             const uint8_t *value,
                             size_t length);
} isocat_application;

/**
 * The verdict as a whole.
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
     * Frames that came back.
     */
    uint64_t answered;
    /**
     * Frames that were lost, in the segment or by a fault.
     */
    uint64_t lost;
    /**
     * Answers that were dropped because more than 8192 had not been received.
     */
    uint64_t overrun;
    /**
     * Number of sessions of MainDevices, one after the other: a session begins when station
     * addresses are written again, or after a long silence.
     */
    size_t sessions;
    /**
     * SubDevices in OP when the judging began last, in the last session.
     */
    size_t in_op;
    /**
     * Judged time of the last session since then, ns.
     */
    int64_t judged_ns;
    /**
     * ISOCAT_NOT_IN_SYNC if there is a finding in any session; else the result of the last
     * session, ISOCAT_IN_SYNC or ISOCAT_NOT_KNOWN.
     */
    int32_t answer;
    /**
     * The result of the segment file's [[expect]] tables: ISOCAT_AS_EXPECTED,
     * ISOCAT_NOT_AS_EXPECTED or ISOCAT_NOT_JUDGED.
     */
    int32_t expected;
} isocat_verdict_summary;

/**
 * The verdict on a SubDevice, since the judging began last. Times are true time, ns.
 */
typedef struct isocat_device_verdict {
    /**
     * sizeof(isocat_device_verdict).
     */
    size_t size;
    /**
     * Its name. This and the other texts are valid as long as the verdict.
     */
    const char *name;
    /**
     * Its state, for example "OP".
     */
    const char *state;
    /**
     * The mode that it actually runs in, for example "dc-sync0".
     */
    const char *mode;
    /**
     * SYNC0 edges that were measured. If 0, the next two fields are 0, too.
     */
    uint64_t sync0_edges;
    /**
     * Mean error of SYNC0 against the grid that the MainDevice wrote.
     */
    double sync0_mean_ns;
    /**
     * Largest error of SYNC0, without sign.
     */
    double sync0_worst_ns;
    /**
     * Cycles with a known margin. If 0, the next field is 0, too.
     */
    uint64_t margins;
    /**
     * Least time from the end of copying and calculating to SYNC0.
     */
    double least_margin_ns;
    /**
     * SM event missed (0x1C32:0B).
     */
    uint32_t sm_event_missed;
    /**
     * Cycle time too small (0x1C32:0C).
     */
    uint32_t cycle_time_too_small;
    /**
     * Shift time too short (0x1C32:0D).
     */
    uint32_t shift_time_too_short;
    /**
     * Sync error (0x1C32:20).
     */
    uint32_t sync_error;
    /**
     * Number of findings against it; isocat_verdict_finding returns their texts.
     */
    size_t findings;
} isocat_device_verdict;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Makes a bus from a segment: all SubDevices that are present from the start are switched on at
 * `now_ns`.
 *
 * `now_ns`: the present on the caller's clock, ns since any instant; at most 2^63 - 1 minus 30
 * days.
 * `bus`: receives the handle, which is freed by isocat_bus_free.
 */
isocat_code isocat_bus_new(const struct isocat_segment *segment,
                           uint64_t now_ns,
                           struct isocat_bus **bus,
                           struct isocat_error **error);

/**
 * Frees a bus; NULL is ignored. A bus that is in use, for example by the call that a callback
 * comes from, is not freed.
 */
void isocat_bus_free(struct isocat_bus *bus);

/**
 * The present of a bus, ns.
 */
isocat_code isocat_bus_now(const struct isocat_bus *bus,
                           uint64_t *now_ns,
                           struct isocat_error **error);

/**
 * Sends a frame at the instant `at_ns`, to which time advances. The frame leaves after the
 * previous frame has left. If an answer comes back, isocat_bus_receive returns it.
 *
 * `port`: 0, or 1 for the other end of a ring.
 * `frame`: is copied; 14 to ISOCAT_LONGEST_FRAME bytes, from the destination address on, without
 * check sequence. A frame below 60 bytes takes as long on the wire as one of 60.
 * `sent`: receives the fate of the frame; may be NULL.
 */
isocat_code isocat_bus_send(struct isocat_bus *bus,
                            uint32_t port,
                            uint64_t at_ns,
                            const uint8_t *frame,
                            size_t length,
                            struct isocat_sent *sent,
                            struct isocat_error **error);

/**
 * When the next answer is back, ns, at any port; in the past if it was not received yet.
 * ISOCAT_NOTHING if no answer is in flight.
 */
isocat_code isocat_bus_next_arrival(const struct isocat_bus *bus,
                                    uint64_t *at_ns,
                                    struct isocat_error **error);

/**
 * Takes the next answer that has come back, including copies made by a fault. ISOCAT_NOTHING if
 * there is none. Time does not advance.
 *
 * `port`: 0, 1, or ISOCAT_ANY_PORT.
 * `buffer`: holds up to `capacity` bytes. ISOCAT_TOO_SMALL: the answer remains, and `arrival` has
 * its length.
 * `arrival`: receives the data of the answer; `size` must be set.
 */
isocat_code isocat_bus_receive(struct isocat_bus *bus,
                               uint32_t port,
                               uint8_t *buffer,
                               size_t capacity,
                               struct isocat_arrival *arrival,
                               struct isocat_error **error);

/**
 * Advances time to `to_ns`, with all that SubDevices do until then. Advancing to the present is
 * allowed and does nothing.
 */
isocat_code isocat_bus_advance(struct isocat_bus *bus, uint64_t to_ns, struct isocat_error **error);

/**
 * When the bus next processes its SubDevices by itself, ns: for programs that want to know when
 * something may happen. isocat_bus_advance does not need it: it processes all such instants on its
 * way. ISOCAT_NOTHING if nothing will happen by itself.
 */
isocat_code isocat_bus_next_timeout(const struct isocat_bus *bus,
                                    uint64_t *at_ns,
                                    struct isocat_error **error);

/**
 * Removes (`up` is 0) or restores the link at a port of the MainDevice now.
 */
isocat_code isocat_bus_link(struct isocat_bus *bus,
                            uint32_t port,
                            int32_t up,
                            struct isocat_error **error);

/**
 * Causes a fault now.
 *
 * `fault`: a line as for `isocat control` and `[[fault]]` tables (docs/faults.md), for example
 * "drop 3", "pull axis 2 for 500ms", "power-cycle 1", "misbehave 1 dead-sync0", "heal". Faults of
 * the host (stall, late-wake-ups, slow-send, clock of the host) are refused, because the caller is
 * the host.
 */
isocat_code isocat_bus_fault(struct isocat_bus *bus,
                             const char *fault,
                             struct isocat_error **error);

/**
 * Causes a fault at the instant `at_ns`, now or later.
 */
isocat_code isocat_bus_fault_at(struct isocat_bus *bus,
                                uint64_t at_ns,
                                const char *fault,
                                struct isocat_error **error);

/**
 * Ends the session of the MainDevice at its last frame. A later frame begins another session.
 */
isocat_code isocat_bus_finish(struct isocat_bus *bus, struct isocat_error **error);

/**
 * The present state of a SubDevice.
 *
 * `state`: receives it; `size` must be set.
 */
isocat_code isocat_device_get_state(struct isocat_bus *bus,
                                    size_t position,
                                    struct isocat_device_state *state,
                                    struct isocat_error **error);

/**
 * The outputs that a SubDevice took last. ISOCAT_NOTHING while they are in their safe state.
 *
 * `buffer`: holds up to `capacity` bytes.
 * `length`: receives the number of bytes; with ISOCAT_TOO_SMALL, the number that is needed.
 */
isocat_code isocat_device_outputs(struct isocat_bus *bus,
                                  size_t position,
                                  uint8_t *buffer,
                                  size_t capacity,
                                  size_t *length,
                                  struct isocat_error **error);

/**
 * Sets the inputs of a SubDevice. They are on the wire after it has mapped its inputs the next
 * time, and remain until they are set again. Bytes of the process image beyond `length` remain
 * those of its application.
 *
 * `inputs`: is copied; at most as many bytes as the SubDevice can have.
 */
isocat_code isocat_device_set_inputs(struct isocat_bus *bus,
                                     size_t position,
                                     const uint8_t *inputs,
                                     size_t length,
                                     struct isocat_error **error);

/**
 * Returns control of the inputs of a SubDevice to its application.
 */
isocat_code isocat_device_release_inputs(struct isocat_bus *bus,
                                         size_t position,
                                         struct isocat_error **error);

/**
 * The code of an error; ISOCAT_OK for NULL.
 */
isocat_code isocat_error_code(const struct isocat_error *error);

/**
 * The description of an error: the place, what was found and what was expected. One line, or two
 * with a hint. Valid as long as the error; NULL for NULL.
 */
const char *isocat_error_text(const struct isocat_error *error);

/**
 * The name of the wrong file; empty if no file is wrong. Valid as long as the error; NULL for
 * NULL.
 */
const char *isocat_error_file(const struct isocat_error *error);

/**
 * The wrong line of that file, from 1; 0 if no line is wrong, and for NULL.
 */
uint32_t isocat_error_line(const struct isocat_error *error);

/**
 * The wrong column in characters, from 1; 0 if no line is wrong, and for NULL.
 */
uint32_t isocat_error_column(const struct isocat_error *error);

/**
 * Frees an error; NULL is ignored.
 */
void isocat_error_free(struct isocat_error *error);

/**
 * Frees a text that the caller owns, which a function returned through a `char **`; NULL is
 * ignored.
 */
void isocat_text_free(char *text);

/**
 * Plans a segment as it is described; sends nothing. Lines that do not fit are no error.
 *
 * `plan`: receives the handle, which is freed by isocat_plan_free.
 */
isocat_code isocat_plan_new(const struct isocat_segment *segment,
                            struct isocat_plan **plan,
                            struct isocat_error **error);

/**
 * The plan as a whole.
 *
 * `summary`: receives it; `size` must be set.
 */
isocat_code isocat_plan_get_summary(const struct isocat_plan *plan,
                                    struct isocat_plan_summary *summary,
                                    struct isocat_error **error);

/**
 * A line of the plan.
 *
 * `number`: from 0.
 * `line`: receives it; `size` must be set.
 */
isocat_code isocat_plan_get_line(const struct isocat_plan *plan,
                                 size_t number,
                                 struct isocat_plan_line *line,
                                 struct isocat_error **error);

/**
 * The part of the plan for a SubDevice.
 *
 * `device`: receives it; `size` must be set.
 */
isocat_code isocat_plan_get_device(const struct isocat_plan *plan,
                                   size_t position,
                                   struct isocat_plan_device *device,
                                   struct isocat_error **error);

/**
 * The plan as a JSON document (docs/plan.schema.json).
 *
 * `json`: receives the text; the caller owns it, and frees it by isocat_text_free.
 */
isocat_code isocat_plan_json(const struct isocat_plan *plan,
                             char **json,
                             struct isocat_error **error);

/**
 * Frees a plan; NULL is ignored.
 */
void isocat_plan_free(struct isocat_plan *plan);

/**
 * ISOCAT_ABI_VERSION of the running library. A program compares it with that of its header.
 */
uint32_t isocat_abi_version(void);

/**
 * The version of the library, for example "0.1.0". Always valid.
 */
const char *isocat_version(void);

/**
 * Returns the built-in segment: two drives, a coupler with a terminal, and a third drive, at 1 ms.
 *
 * `segment`: receives the handle, which is freed by isocat_segment_free.
 */
isocat_code isocat_segment_built_in(struct isocat_segment **segment, struct isocat_error **error);

/**
 * Reads a segment file (TOML, docs/segment-file.md) of at most 16 MiB, and the files that it
 * names.
 *
 * `path`: UTF-8. Relative paths in the file begin at its folder.
 * `segment`: receives the handle, which is freed by isocat_segment_free.
 */
isocat_code isocat_segment_read(const char *path,
                                struct isocat_segment **segment,
                                struct isocat_error **error);

/**
 * Reads a segment file from memory.
 *
 * `text`: `length` bytes of UTF-8, at most 16 MiB; a zero at the end is not needed.
 * `path`: the name in errors; relative paths in the text begin at its folder. NULL: the name is
 * "segment", and paths begin at the working directory.
 */
isocat_code isocat_segment_parse(const uint8_t *text,
                                 size_t length,
                                 const char *path,
                                 struct isocat_segment **segment,
                                 struct isocat_error **error);

/**
 * The number of its SubDevices; 0 for NULL. Positions count from 0, in processing order.
 */
size_t isocat_segment_devices(const struct isocat_segment *segment);

/**
 * The name of a SubDevice in UTF-8; NULL if there is none. Valid as long as the segment.
 */
const char *isocat_segment_device_name(const struct isocat_segment *segment, size_t position);

/**
 * The bus cycle of the description, ns; 0 for NULL.
 */
int64_t isocat_segment_cycle_ns(const struct isocat_segment *segment);

/**
 * The number of MainDevice ports that it needs: 1, or 2 for a ring; 0 for NULL.
 */
uint32_t isocat_segment_ports(const struct isocat_segment *segment);

/**
 * Sets the seed of all random values, for buses that are made from now on. The default is the
 * file's seed.
 */
isocat_code isocat_segment_set_seed(struct isocat_segment *segment,
                                    uint64_t seed,
                                    struct isocat_error **error);

/**
 * Replaces the application of a SubDevice by one of the caller, in buses that are made from now
 * on. Process data, objects and times remain those of its profile. A second call for the same
 * SubDevice replaces the first one.
 *
 * `application`: is copied; `size` must be set. What `user` points to must live as long as the
 * buses.
 */
isocat_code isocat_segment_plug_in(struct isocat_segment *segment,
                                   size_t position,
                                   const struct isocat_application *application,
                                   struct isocat_error **error);

/**
 * Frees a segment; NULL is ignored.
 */
void isocat_segment_free(struct isocat_segment *segment);

/**
 * The verdict at the present instant. The bus continues; at its end, call isocat_bus_finish first.
 *
 * `verdict`: receives the handle, which is freed by isocat_verdict_free.
 */
isocat_code isocat_bus_verdict(struct isocat_bus *bus,
                               struct isocat_verdict **verdict,
                               struct isocat_error **error);

/**
 * The verdict as a whole.
 *
 * `summary`: receives it; `size` must be set.
 */
isocat_code isocat_verdict_get_summary(const struct isocat_verdict *verdict,
                                       struct isocat_verdict_summary *summary,
                                       struct isocat_error **error);

/**
 * The verdict on a SubDevice in the last session. ISOCAT_OUT_OF_RANGE if there is none, because no
 * SubDevice reached operation in it.
 *
 * `device`: receives it; `size` must be set.
 */
isocat_code isocat_verdict_get_device(const struct isocat_verdict *verdict,
                                      size_t position,
                                      struct isocat_device_verdict *device,
                                      struct isocat_error **error);

/**
 * A finding against a SubDevice, as a sentence; NULL if there is none with this number. Valid as
 * long as the verdict.
 *
 * `number`: from 0 to isocat_device_verdict.findings - 1.
 */
const char *isocat_verdict_finding(const struct isocat_verdict *verdict,
                                   size_t position,
                                   size_t number);

/**
 * The whole verdict in words, as `isocat serve` prints it: what the MainDevice did, what it
 * omitted, and the result. Many lines.
 *
 * `text`: receives the text; the caller owns it, and frees it by isocat_text_free.
 */
isocat_code isocat_verdict_text(const struct isocat_verdict *verdict,
                                char **text,
                                struct isocat_error **error);

/**
 * The whole verdict as a JSON document (docs/serve-summary.schema.json).
 *
 * `json`: receives the text; the caller owns it, and frees it by isocat_text_free.
 */
isocat_code isocat_verdict_json(const struct isocat_verdict *verdict,
                                char **json,
                                struct isocat_error **error);

/**
 * Frees a verdict; NULL is ignored.
 */
void isocat_verdict_free(struct isocat_verdict *verdict);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* ISOCAT_H */
