/*
 * Call the functions of an FMU in good and in wrong orders; its sources are part of this program,
 * so that a sanitizer sees them. VERSION is that of FMI.
 */
#if VERSION == 2
#include "fmi2.c"
#define F(name) fmi2##name
#define STATE(name) fmi2##name##FMUstate
#define DESERIALIZE fmi2DeSerializeFMUstate
#define STATE_SIZE fmi2SerializedFMUstateSize
#define GET(values) fmi2GetReal(unit, references, COUNT, values)
#define SET(values) fmi2SetReal(unit, references + ARM_OUTPUTS, ARM_INPUTS, values)
#define STEP(point, size) fmi2DoStep(unit, point, size, 1)
#else
#include "fmi3.c"
#define F(name) fmi3##name
#define STATE(name) fmi3##name##FMUState
#define DESERIALIZE fmi3DeserializeFMUState
#define STATE_SIZE fmi3SerializedFMUStateSize
#define GET(values) fmi3GetFloat64(unit, references, COUNT, values, COUNT)
#define SET(values) \
    fmi3SetFloat64(unit, references + ARM_OUTPUTS, ARM_INPUTS, values, ARM_INPUTS)
#define STEP(point, size) \
    fmi3DoStep(unit, point, size, true, &flags[0], &flags[1], &flags[2], &last)
#endif

#define COUNT (ARM_OUTPUTS + ARM_INPUTS + ARM_PARAMETERS)
#define CHECK(condition) \
    if (!(condition)) { \
        printf("line %d: not %s\n", __LINE__, #condition); \
        return 1; \
    }

#if VERSION == 2
static void print(void *environment, const char *name, fmi2Status status, const char *category,
                  const char *text, ...)
#else
static void print(void *environment, fmi3Status status, const char *category, const char *text)
#endif
{
    printf("%d %s\n", (int)status, text);
}

static void *instantiate(const char *token)
{
#if VERSION == 2
    fmi2CallbackFunctions functions = {.logger = print};
    return fmi2Instantiate("unit", fmi2CoSimulation, token, "", &functions, 0, 0);
#else
    return fmi3InstantiateCoSimulation("unit", token, "", 0, 0, 0, 0, NULL, 0, NULL, print, NULL);
#endif
}

static int begin(void *unit)
{
#if VERSION == 2
    return fmi2SetupExperiment(unit, 0, 0.0, 0.0, 0, 0.0)
        || fmi2EnterInitializationMode(unit) || fmi2ExitInitializationMode(unit);
#else
    return fmi3EnterInitializationMode(unit, 0, 0.0, 0.0, 0, 0.0)
        || fmi3ExitInitializationMode(unit);
#endif
}

int main(void)
{
    unsigned references[COUNT];
    double inputs[ARM_INPUTS], found[COUNT], expected[COUNT], last = 0.0;
    bool flags[3];
    char bytes[sizeof(struct saved)];
    void *state = NULL, *copy = NULL;
    size_t size = 0;
    (void)flags, (void)last;
    for (unsigned k = 0; k < COUNT; ++k)
        references[k] = k;
    for (int k = 0; k < ARM_INPUTS; ++k)
        inputs[k] = 0.1 * k;
    CHECK(!instantiate("wrong") && !instantiate(NULL));
    void *unit = instantiate(TOKEN);
    CHECK(unit);
    CHECK(STEP(0.0, ARM_STEP) == ERROR);
    CHECK(!SET(inputs) && !begin(unit) && begin(unit) == 1);
    CHECK(!STEP(0.0, 3 * ARM_STEP) && STEP(3 * ARM_STEP, 1.5 * ARM_STEP) == NOT_DONE);
    CHECK(!STATE(Get)(unit, &state) && !STATE_SIZE(unit, state, &size) && size == sizeof bytes);
    CHECK(!STATE(Serialize)(unit, state, (void *)bytes, size));
    CHECK(STATE(Serialize)(unit, state, (void *)bytes, size - 1) == ERROR);
    CHECK(!STEP(3 * ARM_STEP, 5 * ARM_STEP) && !GET(expected));
    CHECK(!STATE(Get)(unit, &state) && !STATE(Free)(unit, &state) && !state);
    CHECK(!STATE(Free)(unit, &state) && STATE(Set)(unit, state) == ERROR);
    CHECK(DESERIALIZE(unit, (void *)bytes, size - 1, &copy) == ERROR && !copy);
    CHECK(!DESERIALIZE(unit, (void *)bytes, size, &copy) && !STATE(Set)(unit, copy));
    CHECK(!STEP(3 * ARM_STEP, 5 * ARM_STEP) && !GET(found));
    CHECK(!memcmp(found, expected, sizeof found));
    CHECK(!F(Terminate)(unit) && F(Terminate)(unit) == ERROR && SET(inputs) == ERROR);
    CHECK(!F(Reset)(unit) && !STATE(Free)(unit, &copy));
    references[3] = COUNT;
    CHECK(GET(found) == ERROR);
    F(FreeInstance)(unit);
    F(FreeInstance)(NULL);
    return 0;
}
