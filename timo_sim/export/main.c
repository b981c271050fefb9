/* Run it$under and print a table. */
#include <stdio.h>

#include "name.h"

static double memory[(NAME_SIZE + 7) / 8];

int main(void)
{
    static const int shown[] = {
        NAME_TIME, NAME_SHAFT, NAME_TIP_X, NAME_TIP_Y, NAME_TIP_TRANSVERSE};
    const int count = sizeof shown / sizeof *shown;
    name *instance = (name *)memory;
    int code = name_create(memory, sizeof memory);
$command
    for (int k = 0; k < count; ++k)
        printf("%16s%s", name_output_name(shown[k]), k + 1 < count ? " " : "\n");
    for (int row = 0; code == NAME_OK && row <= 20; ++row) {
        double outputs[NAME_OUTPUTS];
        name_get_outputs(instance, outputs);
        for (int k = 0; k < count; ++k)
            printf("%16.9g%s", outputs[shown[k]], k + 1 < count ? " " : "\n");
        code = name_step(instance, $steps);
    }
    if (code != NAME_OK)
        fprintf(stderr, "%s\n", name_error_text(code));
    return code;
}
