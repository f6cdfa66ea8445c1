/* The port of a MainDevice to libisocat. The functions of such a layer have no handle of the system, so the bus is static here. */
#include "port.h"

#include <stdio.h>

/* How long the calls of a system take. */
#define COST_OF_CLOCK 200
#define COST_OF_SEND 3000

static isocat_segment *segment;
static isocat_bus *bus;
static uint64_t hash = 0xCBF29CE484222325u;

static int failed(isocat_code code, isocat_error *error)
{
    if (code >= 0)
        return 0;
    fprintf(stderr, "%s\n", isocat_error_text(error));
    isocat_error_free(error);
    return -1;
}

static void take_in(const void *bytes, size_t length)
{
    const uint8_t *byte = bytes;
    for (; length > 0; length--, byte++)
        hash = (hash ^ *byte) * 0x100000001B3u;
}

static int64_t now(void)
{
    uint64_t ns = 0;
    isocat_bus_now(bus, &ns, NULL);
    return (int64_t)ns;
}

/* What the program operates; a segment with more in it would have SubDevices that are not in OP. */
static const char TWO_DRIVES[] = "cycle = \"1ms\"\n"
                                 "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis 1\"\nmode = \"dc-sync0\"\n"
                                 "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis 2\"\nmode = \"dc-sync0\"\n";

int nic_setup(const char *path)
{
    isocat_error *error = NULL;
    isocat_code code = path ? isocat_segment_read(path, &segment, &error)
                            : isocat_segment_parse((const uint8_t *)TWO_DRIVES, sizeof TWO_DRIVES - 1, "two drives", &segment, &error);
    if (failed(code, error))
        return -1;
    return failed(isocat_bus_new(segment, 1000000000, &bus, &error), error);
}

void nic_close(void)
{
    isocat_bus_free(bus);
    isocat_segment_free(segment);
    bus = NULL;
    segment = NULL;
}

int nic_send(const void *frame, size_t length)
{
    isocat_error *error = NULL;
    return failed(isocat_bus_send(bus, 0, (uint64_t)(now() + COST_OF_SEND), frame, length, NULL, &error), error);
}

int nic_receive(void *frame, size_t room, int64_t timeout_ns)
{
    int64_t end = now() + timeout_ns;
    for (;;) {
        isocat_error *error = NULL;
        isocat_arrival arrival = {0};
        uint64_t next = (uint64_t)end, at;
        isocat_code code;
        arrival.size = sizeof arrival;
        code = isocat_bus_receive(bus, 0, frame, room, &arrival, &error);
        if (failed(code, error))
            return -1;
        if (code == ISOCAT_OK) {
            take_in(&arrival.at_ns, sizeof arrival.at_ns);
            take_in(frame, arrival.length);
            return (int)arrival.length;
        }
        if (now() >= end)
            return 0;
        if (isocat_bus_next_arrival(bus, &at, NULL) == ISOCAT_OK && at < next)
            next = at;
        if (failed(isocat_bus_advance(bus, next, &error), error))
            return -1;
    }
}

int64_t os_now(void)
{
    isocat_bus_advance(bus, (uint64_t)(now() + COST_OF_CLOCK), NULL);
    return now();
}

void os_sleep_until(int64_t ns)
{
    if (ns > now())
        isocat_bus_advance(bus, (uint64_t)ns, NULL);
}

const isocat_segment *port_segment(void)
{
    return segment;
}

isocat_bus *port_bus(void)
{
    return bus;
}

uint64_t port_hash(void)
{
    return hash;
}
