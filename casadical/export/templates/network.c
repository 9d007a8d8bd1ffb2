@name@_status @name@_network(const @name@_real q[@n@], @name@_real dp_mm[@n_dp@])
{
    @name@_status status;
    if ((q == NULL) || (dp_mm == NULL))
    {
        status = @NAME@_NULL_ARG;
    }
    else
    {
        @name@_real x[@n@];
        status = @name@_boxed(q, @name@_network_lower, @name@_network_upper, x);
        if ((@name@_network_values(x, dp_mm) == 0U) || (status == @NAME@_NOT_FINITE))
        {
            uint32_t i;
            for (i = 0U; i < @n_dp@U; i++)
            {
                dp_mm[i] = @0@;
            }
            status = @NAME@_NOT_FINITE;
        }
    }
    return status;
}

