"""The five experiments of the paper on data from the independent simulator (`make paper`)."""
