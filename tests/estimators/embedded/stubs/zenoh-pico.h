/* What the listener uses of zenoh-pico, to be compiled against alone. */
#include <stddef.h>
#include <stdint.h>

typedef struct { int own; } z_owned_config_t, z_owned_session_t, z_owned_subscriber_t;
typedef struct { int own; } z_owned_closure_sample_t, z_owned_string_t, z_owned_slice_t, z_view_keyexpr_t;
typedef struct { int own; } z_loaned_sample_t, z_loaned_bytes_t;
typedef int8_t z_result_t;

#define Z_CONFIG_CONNECT_KEY 0x41
#define z_loan(x) (&(x))
#define z_loan_mut(x) (&(x))
#define z_move(x) (&(x))
#define z_drop(x) ((void)(x))
#define z_closure(closure, call, drop, context) ((void)(closure), (void)(call))

z_result_t z_config_default(z_owned_config_t *config);
z_result_t zp_config_insert(z_owned_config_t *config, uint8_t key, const char *value);
z_result_t z_open(z_owned_session_t *session, z_owned_config_t *config, const void *options);
z_result_t z_view_keyexpr_from_str(z_view_keyexpr_t *keyexpr, const char *text);
z_result_t z_declare_subscriber(const z_owned_session_t *session, z_owned_subscriber_t *subscriber,
                                z_view_keyexpr_t *keyexpr, z_owned_closure_sample_t *callback,
                                const void *options);
const z_loaned_bytes_t *z_sample_payload(const z_loaned_sample_t *sample);
z_result_t z_bytes_to_string(const z_loaned_bytes_t *bytes, z_owned_string_t *text);
const char *z_string_data(const z_owned_string_t *text);
size_t z_string_len(const z_owned_string_t *text);
z_result_t z_bytes_to_slice(const z_loaned_bytes_t *bytes, z_owned_slice_t *slice);
const uint8_t *z_slice_data(const z_owned_slice_t *slice);
size_t z_slice_len(const z_owned_slice_t *slice);
