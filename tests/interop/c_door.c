/* libisocat from C, and from C++ as well: versions, errors, an application of one's own, and everything made and freed as often as the
 * argument says, so that what stays can be counted. Prints what went wrong, and ends with 1 then. */
#include <isocat.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int wrong;

static void check(int good, const char *what)
{
    if (!good) {
        printf("c_door: not so: %s\n", what);
        wrong = 1;
    }
}

static void switched_off(void *user)
{
    ++*(int *)user;
}

static void hostile(isocat_bus *bus)
{
    isocat_error *error = NULL;
    uint8_t frame[60] = {0};
    isocat_sent sent;
    uint64_t now = 0;
    memset(&sent, 0, sizeof sent);
    check(isocat_bus_send(NULL, 0, 0, frame, sizeof frame, NULL, NULL) == ISOCAT_NULL_ARGUMENT, "a bus that is NULL");
    check(isocat_bus_send(bus, 0, 1000, frame, (size_t)1 << (sizeof(size_t) * 8 - 1), NULL, NULL) == ISOCAT_OUT_OF_RANGE,
          "a frame of half the memory");
    check(isocat_bus_send(bus, 0, 999, frame, sizeof frame, NULL, &error) == ISOCAT_TIME, "an instant that has passed");
    check(error != NULL && isocat_error_code(error) == ISOCAT_TIME && strstr(isocat_error_text(error), "999") != NULL,
          "its error in words");
    isocat_error_free(error);
    check(isocat_bus_send(bus, 0, 1000, frame, sizeof frame, &sent, NULL) == ISOCAT_STRUCT_SIZE, "a size that was not set");
    sent.size = sizeof sent;
    check(isocat_bus_send(bus, 0, 1000, frame, sizeof frame, &sent, NULL) == ISOCAT_OK && sent.comes_back == 0,
          "a frame of zeros, which is no EtherCAT");
    check(isocat_bus_now(bus, &now, NULL) == ISOCAT_OK && now == 1000, "the present");
}

static void once(void)
{
    static const char text[] = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = 3\n";
    int off = 0;
    isocat_application application;
    isocat_segment *segment = NULL;
    isocat_bus *bus = NULL;
    isocat_plan *plan = NULL;
    isocat_verdict *verdict = NULL;
    char *json = NULL;
    memset(&application, 0, sizeof application);
    application.size = sizeof application;
    application.user = &off;
    application.power_off = switched_off;
    check(isocat_segment_parse((const uint8_t *)text, strlen(text), NULL, &segment, NULL) == ISOCAT_OK, "a segment");
    check(isocat_segment_plug_in(segment, 1, &application, NULL) == ISOCAT_OK, "an application");
    check(isocat_plan_new(segment, &plan, NULL) == ISOCAT_OK, "a plan");
    check(isocat_bus_new(segment, 1000, &bus, NULL) == ISOCAT_OK, "a bus");
    isocat_segment_free(segment);
    hostile(bus);
    check(isocat_bus_fault(bus, "power-off 1", NULL) == ISOCAT_OK, "a fault");
    check(isocat_bus_advance(bus, 1000000000, NULL) == ISOCAT_OK && off == 1, "the application was told");
    check(isocat_bus_verdict(bus, &verdict, NULL) == ISOCAT_OK, "a verdict");
    isocat_bus_free(bus);
    check(isocat_verdict_json(verdict, &json, NULL) == ISOCAT_OK && json != NULL && json[0] == '{', "the verdict in JSON");
    isocat_text_free(json);
    isocat_verdict_free(verdict);
    isocat_plan_free(plan);
}

int main(int argc, char **argv)
{
    long times = argc > 1 ? strtol(argv[1], NULL, 10) : 1;
    check(isocat_abi_version() == ISOCAT_ABI_VERSION, "the library is of the header's age");
    for (; times > 0; times--)
        once();
    if (!wrong)
        printf("c_door: isocat %s: as it should be\n", isocat_version());
    return wrong;
}
