/* What `isocat plan --for soem` uses of SOEM 2, by its documentation. Our own declarations: the library is not needed
 * to check a call. */
#ifndef SOEM_H
#define SOEM_H
#include <stdint.h>
typedef uint8_t boolean, uint8;
typedef uint16_t uint16;
typedef uint32_t uint32;
typedef int32_t int32;
typedef int64_t int64;
#define TRUE 1
#define FALSE 0
#define EC_TIMEOUTRET 2000
#define EC_TIMEOUTRXM 700000
#define EC_TIMEOUTSTATE 2000000
#define EC_STATE_INIT 1
#define EC_STATE_PRE_OP 2
#define EC_STATE_SAFE_OP 4
#define EC_STATE_OPERATIONAL 8
#define htoes(value) (value)
#define etohl(value) (value)
typedef struct { int unused; } ecx_portt;
typedef struct ecx_context ecx_contextt;
typedef struct {
   uint16 state, ALstatuscode, configadr;
   uint32 eep_man, eep_id, Obytes, Ibytes;
   int (*PO2SOconfig)(ecx_contextt *context, uint16 slave);
} ec_slavet;
struct ecx_context {
   ecx_portt port;
   ec_slavet slavelist[200];
   int slavecount, manualstatechange;
   int64 DCtime;
};
int ecx_init(ecx_contextt *, const char *interface);
int ecx_config_init(ecx_contextt *);
int ecx_config_map_group(ecx_contextt *, void *image, uint8 group);
boolean ecx_configdc(ecx_contextt *);
void ecx_dcsync0(ecx_contextt *, uint16 slave, boolean on, uint32 cycle, int32 shift);
void ecx_dcsync01(ecx_contextt *, uint16 slave, boolean on, uint32 cycle0, uint32 cycle1, int32 shift);
int ecx_SDOwrite(ecx_contextt *, uint16 slave, uint16 index, uint8 sub, boolean complete, int size, const void *, int timeout);
int ecx_FPWR(ecx_portt *, uint16 address, uint16 offset, uint16 length, void *, int timeout);
int ecx_FPRD(ecx_portt *, uint16 address, uint16 offset, uint16 length, void *, int timeout);
int ecx_send_processdata(ecx_contextt *);
int ecx_receive_processdata(ecx_contextt *, int timeout);
int ecx_writestate(ecx_contextt *, uint16 slave);
int ecx_readstate(ecx_contextt *);
uint16 ecx_statecheck(ecx_contextt *, uint16 slave, uint16 state, int timeout);
char *ec_ALstatuscode2string(uint16 code);
int osal_usleep(uint32);
#endif
