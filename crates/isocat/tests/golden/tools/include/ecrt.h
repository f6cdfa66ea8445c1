/* The calls of the EtherLab master's application interface that `isocat plan --for igh` prints, as its documentation
 * publishes them (version 1.5.2). Our own declarations: the library is not needed to check a call. */
#ifndef ECRT_H
#define ECRT_H
#include <stddef.h>
#include <stdint.h>
#define EC_END ~0U
typedef struct ec_master ec_master_t;
typedef struct ec_slave_config ec_slave_config_t;
typedef struct ec_domain ec_domain_t;
typedef enum { EC_DIR_INVALID, EC_DIR_OUTPUT, EC_DIR_INPUT } ec_direction_t;
typedef enum { EC_WD_DEFAULT, EC_WD_ENABLE, EC_WD_DISABLE } ec_watchdog_mode_t;
typedef struct { uint16_t index; uint8_t subindex; uint8_t bit_length; } ec_pdo_entry_info_t;
typedef struct { uint16_t index; unsigned int n_entries; ec_pdo_entry_info_t *entries; } ec_pdo_info_t;
typedef struct {
   uint8_t index; ec_direction_t dir; unsigned int n_pdos; ec_pdo_info_t *pdos; ec_watchdog_mode_t watchdog_mode;
} ec_sync_info_t;
ec_slave_config_t *ecrt_master_slave_config(ec_master_t *, uint16_t alias, uint16_t position, uint32_t vendor, uint32_t product);
int ecrt_master_select_reference_clock(ec_master_t *, ec_slave_config_t *);
int ecrt_slave_config_pdos(ec_slave_config_t *, unsigned int count, const ec_sync_info_t[]);
int ecrt_slave_config_reg_pdo_entry_pos(ec_slave_config_t *, uint8_t sync_manager, unsigned int pdo, unsigned int entry,
                                        ec_domain_t *, unsigned int *bit);
void ecrt_slave_config_dc(ec_slave_config_t *, uint16_t assign_activate, uint32_t sync0_cycle, int32_t sync0_shift,
                          uint32_t sync1_cycle, int32_t sync1_shift);
void ecrt_slave_config_watchdog(ec_slave_config_t *, uint16_t divider, uint16_t intervals);
int ecrt_slave_config_sdo(ec_slave_config_t *, uint16_t index, uint8_t sub, const uint8_t *, size_t);
int ecrt_slave_config_sdo8(ec_slave_config_t *, uint16_t index, uint8_t sub, uint8_t);
int ecrt_slave_config_sdo16(ec_slave_config_t *, uint16_t index, uint8_t sub, uint16_t);
int ecrt_slave_config_sdo32(ec_slave_config_t *, uint16_t index, uint8_t sub, uint32_t);
int ecrt_slave_config_complete_sdo(ec_slave_config_t *, uint16_t index, const uint8_t *, size_t);
void ecrt_master_receive(ec_master_t *);
size_t ecrt_master_send(ec_master_t *);
void ecrt_domain_process(ec_domain_t *);
void ecrt_domain_queue(ec_domain_t *);
void ecrt_master_application_time(ec_master_t *, uint64_t);
void ecrt_master_sync_reference_clock(ec_master_t *);
void ecrt_master_sync_slave_clocks(ec_master_t *);
#endif
