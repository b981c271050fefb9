#include <stdint.h>
static const struct field { int place, number; } fields[] = {$fields};
static const unsigned char head[] = {$head}, data[] = {$data};
static const struct message {
    int channel, commanded, size, stamp;
    const unsigned char *data;
    int count;
    const struct field *fields;
} messages[] = {$messages};
const struct {
    double step;
    const unsigned char *head;
    int64_t head_size;
    int count;
    const struct message *messages;
} arm_scene = {$step, head, sizeof head, $count, messages};
