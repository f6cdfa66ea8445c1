/* What a MainDevice needs of a machine: a network interface, a clock, sleep. Stacks have such a layer, and a folder for each system
 * (SOEM calls its two oshw and osal); this one is for a system whose only interface leads to a virtual segment, and whose time
 * is virtual. A stack is moved to it by writing its own layer as port.c is written. */
#ifndef PORT_H
#define PORT_H

#include <stddef.h>
#include <stdint.h>

#include <isocat.h>

/* The interface. `segment`: a segment file, or NULL for the built-in segment. 0 on success; else it has said what is wrong. */
int nic_setup(const char *segment);
void nic_close(void);
/* Sends a frame. 0 on success. */
int nic_send(const void *frame, size_t length);
/* Waits for a frame; gives its length, 0 if none came in time, or -1. */
int nic_receive(void *frame, size_t room, int64_t timeout_ns);

/* The clock, ns. Reading it takes time, too: so loops that wait for it come to an end. */
int64_t os_now(void);
void os_sleep_until(int64_t ns);

/* What a test wants to see. */
const isocat_segment *port_segment(void);
isocat_bus *port_bus(void);
/* Of all frames that came back, and when. */
uint64_t port_hash(void);

#endif
