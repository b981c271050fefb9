/*
 * A flexible arm, exported by timo_sim $version for $target.
 *
 * An instance lives in memory that its caller owns, NAME_SIZE bytes at an address that is a
 * multiple of 8. Nothing is allocated or printed. Instances are independent; one instance is for
 * one thread at a time. Functions return NAME_OK or another code of enum name_code; a call that
 * fails changes nothing, but a step that diverges leaves the steps before it done.
 */
#ifndef NAME_H
#define NAME_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define NAME_STEP $step /* time step [s] */
#define NAME_SIZE $size /* of an instance [bytes] */
#define NAME_STATE_SIZE $saved /* count of numbers of a saved state */
#define NAME_INPUTS $inputs /* count of inputs */
#define NAME_OUTPUTS $outputs /* count of outputs */
#define NAME_PARAMETERS $parameters /* count of parameters */
#define NAME_MOTION $motion /* count of numbers of a motion */
#define NAME_SHAPE $drawn /* count of points of a shape */

enum name_code {
$codes
};

/* Inputs act besides the loads of the scene, from the next step on until they are set again. */
enum name_input {
$input_list
};

enum name_output {
$output_list
};

/* Parameters are the scene's until they are set; they are > 0, and INFINITY is no limit. */
enum name_parameter {
$parameter_list
};

typedef struct name name;

/* Size of an instance in bytes, NAME_SIZE. */
size_t name_size(void);

/* Make an instance of `size` bytes of memory, at the start of the scene; it is a name * then. */
int name_create(void *memory, size_t size);

/* Return to the start of the scene, with inputs 0; parameters stay. */
int name_reset(name *instance);

/* Set or get an input. */
int name_set_input(name *instance, int input, double value);
int name_get_input(const name *instance, int input, double *value);

/* Set or get a parameter; what acts of inputs goes on from its value at this step. */
int name_set_parameter(name *instance, int parameter, double value);
int name_get_parameter(const name *instance, int parameter, double *value);

/* Advance by some time steps, under constant inputs. */
int name_step(name *instance, int64_t steps);

/*
 * Get the derivatives of the motion after the next step, which is not done, under the inputs of
 * now: values[k][i] is that of number i by number k of the motion now or, from NAME_MOTION on, by
 * input k - NAME_MOTION. A motion is carrier x, y and shaft, the modal coordinates, then the rate
 * of each; rows and columns of what is held, locked or driven are 0.
 */
int name_step_derivatives(name *instance,
                          double values[NAME_MOTION + NAME_INPUTS][NAME_MOTION]);

/* Get an output, or all of them, at the end of the last step; the first call computes them. */
int name_get_output(name *instance, int output, double *value);
int name_get_outputs(name *instance, double values[NAME_OUTPUTS]);

/*
 * Get the arm's shape, to draw: x and y of points of the centre line in the world [m], at equal
 * distances along the arm from its root, which is the hub's radius from the carrier, to its tip.
 */
int name_get_shape(name *instance, double values[NAME_SHAPE][2]);

$finer/* Get or set the state: time, inputs, parameters, motion; runs go on from it to the last bit. */
int name_get_state(const name *instance, double values[NAME_STATE_SIZE]);
int name_set_state(name *instance, const double values[NAME_STATE_SIZE]);

/* Texts; "unknown" for a number that is none. */
const char *name_error_text(int code);
const char *name_input_name(int input);
const char *name_input_unit(int input);
const char *name_output_name(int output);
const char *name_output_unit(int output);
const char *name_parameter_name(int parameter);
const char *name_parameter_unit(int parameter);

#ifdef __cplusplus
}
#endif

#endif
