/* Print whether something leans on each joint of an arm, and by which torque as far as that is known,
 * ten times a second: zenoh-pico and C11.
 *
 *     contact_listener tcp/192.168.1.3:7448 iiwa14
 *
 * Before any news, and after 0.3 s without, every joint is unknown and its torque NaN: a service,
 * router or cable that is gone is no free joint. */
#define _POSIX_C_SOURCE 200809L

#include "contact_state.h"
#include "external_torque.h"

#include <pthread.h>
#include <stdio.h>
#include <time.h>
#include <zenoh-pico.h>

static pthread_mutex_t held = PTHREAD_MUTEX_INITIALIZER;
static contact_state latest;
static external_torque felt;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static void hear(z_loaned_sample_t *sample, void *context)
{
    z_owned_string_t text;
    (void)context;
    if (z_bytes_to_string(z_sample_payload(sample), &text) < 0) {
        return;
    }
    pthread_mutex_lock(&held);
    contact_read(&latest, z_string_data(z_loan(text)), z_string_len(z_loan(text)), now());
    pthread_mutex_unlock(&held);
    z_drop(z_move(text));
}

static void feel(z_loaned_sample_t *sample, void *context)
{
    z_owned_slice_t bytes;
    (void)context;
    if (z_bytes_to_slice(z_sample_payload(sample), &bytes) < 0) {
        return;
    }
    pthread_mutex_lock(&held);
    external_read(&felt, z_slice_data(z_loan(bytes)), z_slice_len(z_loan(bytes)), now());
    pthread_mutex_unlock(&held);
    z_drop(z_move(bytes));
}

static bool listen(const z_owned_session_t *session, z_owned_subscriber_t *subscriber, const char *arm,
                   const char *what, void (*call)(z_loaned_sample_t *, void *))
{
    char key[256];
    z_owned_closure_sample_t callback;
    z_view_keyexpr_t where;
    z_closure(&callback, call, NULL, NULL);
    if (snprintf(key, sizeof key, "limo/%s/%s", arm, what) >= (int)sizeof key ||
        z_view_keyexpr_from_str(&where, key) < 0 ||
        z_declare_subscriber(z_loan(*session), subscriber, z_loan(where), z_move(callback), NULL) < 0) {
        fprintf(stderr, "limo/%s/%s cannot be listened to\n", arm, what);
        return false;
    }
    return true;
}

int main(int argc, char **argv)
{
    static const char *const names[] = {"unknown", "free", "contact"};
    const struct timespec pause = {0, 100000000};
    z_owned_config_t config;
    z_owned_session_t session;
    z_owned_subscriber_t contacts, torques;
    if (argc != 3) {
        fprintf(stderr, "usage: contact_listener ENDPOINT ARM\n");
        return 2;
    }
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, argv[1]);
    if (z_open(&session, z_move(config), NULL) < 0) {
        fprintf(stderr, "no Zenoh session with %s\n", argv[1]);
        return 1;
    }
    if (!listen(&session, &contacts, argv[2], "contact", hear) ||
        !listen(&session, &torques, argv[2], "torque/known", feel)) {
        return 1;
    }
    for (;; nanosleep(&pause, NULL)) {
        pthread_mutex_lock(&held);
        const contact_state state = latest;
        const external_torque torque = felt;
        pthread_mutex_unlock(&held);
        for (size_t joint = 1; joint <= state.count; ++joint) {
            printf("%s %.3f ", names[contact_of(&state, joint, now())],
                   external_of(&torque, joint, now()));
        }
        puts(state.count ? "" : "unknown");
        fflush(stdout);
    }
}
