static void run_network(double *memory, const double x[INPUTS], double y[N])
{
    (void)memory;
    for (int g = 0; g < PARTS; ++g) {
        double hidden[HIDDEN];
        for (int u = 0; u < HIDDEN; ++u) {
            hidden[u] = hidden_bias[g][u];
        }
        for (int k = 0; k < PART_INPUTS; ++k) {
            const double value = x[part_input[g][k]];
            for (int u = 0; u < HIDDEN; ++u) {
                hidden[u] += value * hidden_weight[g][k][u];
            }
        }
        for (int i = 0; i < PART_OUTPUTS; ++i) {
            double total = output_bias[g][i];
            for (int u = 0; u < HIDDEN; ++u) {
                total += fmax(hidden[u], 0.0) * output_weight[g][u][i];
            }
            y[g * PART_OUTPUTS + i] = total;
        }
    }
}
