#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What the model remembers of the motion. */
typedef struct {
    double effects[LIMO_EFFECT_MEMORY];
    double joints[LIMO_JOINT_MEMORY];
    double network[LIMO_NETWORK_MEMORY];
} limo_memory;

/* All that is remembered of one arm; several arms have one each. */
typedef struct {
    double time;      /* of the last position [s]; NAN before the first */
    size_t oldest;    /* row of `line` */
    size_t received;  /* positions since the start or the last gap */
    bool with_torque; /* whether torque comes with the positions */
    double line[2 * LIMO_TAPS][2 * LIMO_LANES]; /* positions and torques, twice in a row */
#if LIMO_RESTS
    double anchors[LIMO_JOINTS][LIMO_RESTS]; /* where each joint rests, and the encoder's noise */
#endif
#if LIMO_TORQUE_TAPS > 1
    size_t oldest_torque;
    double torques[2 * LIMO_TORQUE_TAPS][LIMO_TORQUES * LIMO_LANES]; /* likewise, of the model */
#endif
    limo_memory model;
#if LIMO_CONTACT
    double lowest[LIMO_JOINTS], highest[LIMO_JOINTS]; /* positions since memory began */
    bool contact[LIMO_JOINTS];                        /* as it was last known */
    size_t unlike[LIMO_JOINTS]; /* samples for which the motion counts as unlike the free one */
#endif
} limo_state;

/* The torque at `time`, positive along the joint axes; all [N m] but where it says otherwise. */
typedef struct {
    double time;                   /* [s]; LIMO_DELAY before that of the position */
    double torque[LIMO_JOINTS];    /* simulation + learned */
    double simulation[LIMO_JOINTS];
    double learned[LIMO_JOINTS];
    double deviation[LIMO_JOINTS]; /* one standard deviation of the error; NAN where unknown */
    double gravity[LIMO_JOINTS];   /* what holds the arm with its payload still, in its pose */
    double payload[LIMO_JOINTS];   /* what of the rigid body's torque the payload needs */
    double friction[LIMO_JOINTS];  /* what of the simulation is friction */
    double measured[LIMO_JOINTS];  /* behind the same filter; NAN where none is given */
    double external[LIMO_JOINTS];  /* measured - torque: -J^T of the wrench on the arm */
    bool outside[LIMO_JOINTS];     /* unlike what was learned; the deviation is a guess there */
#if LIMO_CONTACT
    double threshold[LIMO_JOINTS]; /* of external torque, from where on it is a contact */
    bool contact[LIMO_JOINTS];     /* external torque is beyond it; as before while a gap is filled */
    bool known[LIMO_JOINTS];       /* contact is: not after a start or gap, where outside, nor
                                    * in motion that free motion did not show */
#endif
    bool filled;                   /* the filter has forgotten the start or the last gap */
} limo_estimate;

typedef enum {
    LIMO_OK = 0,
    LIMO_NOT_FINITE = 1,    /* a time or value is not finite, or a value beyond 1e9 */
    LIMO_TIME_STOOD = 2,    /* the time does not increase; set back by a gap, all begins anew */
    LIMO_TORQUE_CHANGED = 3 /* torque came or went; it comes with each position or with none */
} limo_status;

/* Return sizeof(limo_state), for who keeps it without this header. */
size_t limo_size(void);

/* Begin: before the first position, at which the arm is taken to have rested. */
void limo_init(limo_state *state);

/* Begin anew, as after a long gap, which limo_step finds by itself. */
void limo_reset(limo_state *state);

/* Take the next position [rad], and the torque [N m] measured with it, or NULL.
 * Anything but LIMO_OK leaves state and estimate as they were. */
limo_status limo_step(limo_state *state, double time, const double position[LIMO_JOINTS],
                      const double *torque, limo_estimate *estimate);

/* The same model on a motion whose derivatives are known, such as a commanded one: no filter, no
 * delay. What is measured, and so contact, is not filled. */
void limo_model_init(limo_memory *memory);
limo_status limo_model_step(limo_memory *memory, double time, const double position[LIMO_JOINTS],
                            const double velocity[LIMO_JOINTS],
                            const double acceleration[LIMO_JOINTS], limo_estimate *estimate);

#ifdef __cplusplus
}
#endif
