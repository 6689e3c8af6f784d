/* Run a target on files, without libFuzzer: `target FILE...`. Any C compiler will do, with sanitizers or without. */
#include <stdio.h>

#include "fuzz_input.h"

#define LONGEST 65536u

int main(int n_arguments, char **arguments)
{
    static uint8_t octets[LONGEST];
    for (int i = 1; i < n_arguments; i++) {
        FILE *file = fopen(arguments[i], "rb");
        if (file == NULL) {
            (void)fprintf(stderr, "cannot read %s\n", arguments[i]);
            return 2;
        }
        size_t n = fread(octets, 1, LONGEST, file);
        (void)fclose(file);
        uint8_t *input = malloc(n ? n : 1); /* of just its size: reading past its end is seen */
        LAW(input != NULL);
        for (size_t at = 0; at < n; at++) input[at] = octets[at];
        (void)LLVMFuzzerTestOneInput(input, n);
        free(input);
    }
    return 0;
}
