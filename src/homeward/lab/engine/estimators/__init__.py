"""The filters as online estimators."""
